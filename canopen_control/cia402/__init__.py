"""CiA 402: the drive profile, sans-IO."""
