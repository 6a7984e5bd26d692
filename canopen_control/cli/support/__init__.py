"""What verbs share: targets and arguments, tables and progress, files and layouts, completion, parts of large verbs."""
