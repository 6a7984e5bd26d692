"""What the reports of a bench need to be printed."""

MACHINE = {
    "machine": "2 x M",
    "kernel": "K",
    "python": "P",
    "package": "pure Python",
    "date": "D",
    "nice": 0,
    "load": 0.1,
    "idle": 0.99,
    "processors": "kept awake",
}
