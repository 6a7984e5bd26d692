"""Runtime: one thread that owns a robot's buses, its control loop, and the socket of its clients."""
