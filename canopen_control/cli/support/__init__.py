"""Common parts of the verbs: targets, arguments, tables, progress, files and shell completion."""
