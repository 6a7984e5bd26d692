"""Common parts of verbs: targets, arguments, tables, progress, files, completion."""
