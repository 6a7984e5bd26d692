"""What we are measured beside: programs of their own, each in the fastest idiom that its package documents."""
