"""Runtime: one thread for a robot's buses, its control loop, and the socket of its clients."""
