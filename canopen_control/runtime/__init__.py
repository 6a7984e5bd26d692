"""The runtime: one thread that owns a robot's buses, its control loop, and the socket its clients use."""
