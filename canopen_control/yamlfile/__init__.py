"""YAML files, read into frozen dataclasses, with every mistake of a file told at once and with its place."""
