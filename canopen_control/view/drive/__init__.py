"""Drive view of the page: shows one node in tabs, next to STOP and the robot's state.

To add a tab, write a file NAME_tab.py in this folder with a class that follows the protocol `drive_tab.DriveTab`, and
add the class to `drive_view.TABS`. A tab is created in the current container when the user first opens it for a node.
It gets a `DriveTabContext`:

- `context.panel` is common to all panels of the page: `ask(request)` sends a request to the robot, `hold` and `release`
  drive while a button is held, `teleop` is True if this page may write and move at all.
- `context.node_jobs` are the jobs of the node, shared by all pages: `await node_jobs.ask(work)` runs `work(session)` on
  a thread, with a `NodeSession` whose SDO requests go through the robot; `node_jobs.begin(JobRun(job, title), work)`
  starts a job of `commissioning.jobs`. A node runs one job at a time, which continues if the page is closed;
  `JobForm(job)` creates the inputs of its options. A tab must not block the event loop, because STOP would be delayed.
- `context.node` is the name of the node, `context.place` has its node-ID, EDS and joints.

`show(content)` is called a few times a second while the tab is visible, `leave()` when the tab is hidden; reading and
driving must end then. Tabs contain no logic: the meaning of an object, or whether a file fits, is decided in
`commissioning`.
"""
