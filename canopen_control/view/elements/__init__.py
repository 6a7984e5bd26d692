"""Page elements that NiceGUI lacks, written in Python and JavaScript."""
