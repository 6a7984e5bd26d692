"""Drive view: one node of the robot, in tabs, next to STOP and the robot's state.

How to add a tab: a file NAME_tab.py in this folder with a class that is a `drive_tab.DriveTab`, and a line for it in
`drive_view.TABS`. A tab is made when it is opened first, for one node, in the place that is current; what it is given
is a `DriveTabContext`:

- `context.panel` is common to all panels of the page: `ask(request)` sends a request to the robot, `hold` and `release`
  drive while a button is held, `teleop` is True if this page may write and move at all.
- `context.desk` is the node, shared by all pages: `await desk.ask(work)` runs `work(session)` on a thread, with a
  `NodeSession` whose SDO goes through the robot; `desk.begin(JobRun(job, title), work)` begins a job of
  `commissioning.jobs`, one at a time on a node, which goes on where the page is closed meanwhile; `JobForm(job)` makes
  the inputs of its options. No tab waits in the loop: STOP would wait behind it.
- `context.node` is its name, `context.place` its node id, EDS and joints.

`show(content)` is called a few times a second while the tab is seen, `leave()` when it is not any more: what it reads
or drives ends there. Tabs contain no logic: what an object means, or whether a file fits, is for `commissioning`.
"""
