"""The browser view: the robot, its wheels, plots, events and a STOP, on a page of this computer.

A process of its own and a client of the runtime. The only room that imports NiceGUI.
"""
