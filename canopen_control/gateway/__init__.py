"""CiA 309-3: a bus or a running robot for clients of other networks, by lines of text."""
