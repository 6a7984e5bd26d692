"""YAML files as frozen dataclasses; all mistakes of a file are reported at once, with their places."""
