"""Runtime of a robot: a single thread runs its CAN buses, its control loop and the socket for its clients."""
