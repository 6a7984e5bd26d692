"""Other CANopen software, given what we have."""
