"""YAML files as frozen dataclasses; all errors of a file are reported at once, with their positions."""
