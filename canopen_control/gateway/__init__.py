"""CiA 309-3 gateway, which gives clients in other networks text access to a bus or a running robot."""
