"""CiA 306: object dictionaries, their values, and the files that describe them."""
