"""CiA 309-3 gateway: gives clients in other networks text access to a bus or a running robot."""
