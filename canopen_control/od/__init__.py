"""Object dictionaries, their values, and EDS and DCF files (CiA 306)."""
