"""Page elements that the toolkit lacks: each a few lines of Python and its JavaScript."""
