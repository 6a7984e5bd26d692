"""CiA 309-3 gateway: text access to a bus or a running robot for clients of other networks."""
