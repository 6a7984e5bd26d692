"""A mixed campaign against a running robot: a seeded script of attacks, and an independent observer that judges motion.

`script` makes the actions, `driver` does them, `observer` hears the bus and tells what must not be. `tools/campaign`
runs it. Nothing of it is part of the package, and the observer decodes the bus by itself: no word of the
runtime counts.
"""
