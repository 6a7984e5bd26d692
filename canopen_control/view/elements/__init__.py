"""What the page needs that the toolkit has not: each a few lines of Python and its JavaScript."""
