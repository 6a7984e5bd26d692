"""Programs with made types, and the bridge, never stand still: the loops in which they did, with both kinds of types.

Fast DDS calls a type support while it holds its mutexes; Python in such a call, and a thread that waits for the same
mutex with the GIL, were two that wait for each other. CANOPEN_CONTROL_LOOP_S is how long each loop runs, in s; where it
is set, they run with the types of ROS's own generators too.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from support import ros
from support.compiled_interfaces import missing
from support.host import eventually
from support.robots import PATIENT_ROBBY, copy_robby

from canopen_control.ros.interfaces.definition import DEFINITIONS

LOOP_S = float(os.environ.get("CANOPEN_CONTROL_LOOP_S", "4"))
LONG = "CANOPEN_CONTROL_LOOP_S" in os.environ
COMPILED = pytest.param("compiled", marks=pytest.mark.skipif(missing() is not None, reason=str(missing())))
KINDS = ["made", COMPILED] if LONG else ["made"]  # compiling takes longer than a short loop
pytestmark = [pytest.mark.ros, pytest.mark.timed, pytest.mark.timeout(120 + 2 * LOOP_S + 600 * LONG)]
BUILDER = Path(ros.__file__).with_name("compiled_interfaces.py")
PACKAGES = {
    "tf2_msgs": (["msg/TFMessage"], ["geometry_msgs", "std_msgs", "builtin_interfaces"]),
    "controller_manager_msgs": (
        [
            "msg/ChainConnection", "msg/ControllerState", "srv/ConfigureController", "srv/ListControllers",
            "srv/LoadController", "srv/SwitchController", "srv/UnloadController",
        ],
        ["lifecycle_msgs", "service_msgs", "builtin_interfaces"],
    ),
}  # fmt: skip
BEGIN = """
import faulthandler, sys, threading, time
faulthandler.dump_traceback_later(float(sys.argv[2]) + 30, exit=True)  # where each thread stands
if sys.argv[1] == "made":
    from canopen_control.ros.interfaces import provide
    assert {"tf2_msgs", "controller_manager_msgs"} <= set(provide())
import rclpy
rclpy.init()
node = rclpy.create_node("loop")
end = time.monotonic() + float(sys.argv[2])
"""
#: two threads publish on one publisher
PUBLISH = """
from tf2_msgs.msg import TFMessage
assert (TFMessage.__module__ == "tf2_msgs.msg") == (sys.argv[1] == "made")
publisher, counts = node.create_publisher(TFMessage, "loop", 10), [0, 0]
node.create_subscription(TFMessage, "loop", lambda message: None, 10)
def run(which):
    message = TFMessage()
    while time.monotonic() < end:
        publisher.publish(message)
        counts[which] += 1
threads = [threading.Thread(target=run, args=(which,), daemon=True) for which in range(2)]
for each in threads: each.start()
for each in threads: each.join()
print(min(counts))
"""
#: the commonest pattern: a thread spins, another makes a client, calls, and destroys it
CALL = """
from controller_manager_msgs.srv import ListControllers
threading.Thread(target=lambda: rclpy.spin(node), daemon=True).start()
count = 0
while time.monotonic() < end:
    client = node.create_client(ListControllers, "/controller_manager/list_controllers")
    assert client.wait_for_service(20), count
    answered = threading.Event()
    client.call_async(ListControllers.Request()).add_done_callback(lambda _: answered.set())
    assert answered.wait(60), count
    node.destroy_client(client)
    count += 1
print(count, flush=True)
import os
os._exit(0)
"""
#: controllers come and go, and with them the bridge's topics and services
CHURN = """
from controller_manager_msgs import srv
clients = {}
def call(kind, service, **fields):
    if service not in clients:
        clients[service] = node.create_client(kind, "/controller_manager/" + service)
        assert clients[service].wait_for_service(20)
    future = clients[service].call_async(kind.Request(**fields))
    rclpy.spin_until_future_complete(node, future, timeout_sec=20)
    assert future.done(), (count, service)
count = 0
while time.monotonic() < end:
    name = ("robby_base_controller", "robby_forward_controller")[count % 2]
    call(srv.LoadController, "load_controller", name=name)
    call(srv.ConfigureController, "configure_controller", name=name)
    call(srv.SwitchController, "switch_controller", activate_controllers=[name], strictness=2)
    call(srv.SwitchController, "switch_controller", deactivate_controllers=[name], strictness=2)
    call(srv.UnloadController, "unload_controller", name=name)
    count += 1
print(count)
"""


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """The packages as ROS's own generators compile them: the variables by which a program finds them.

    The first worker that needs them compiles them, and the others wait for it.
    """
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "compiled_packages"
    folder.mkdir(exist_ok=True)
    with open(folder / "lock", "a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").exists():
            for package, (names, dependencies) in PACKAGES.items():
                definitions = {name: DEFINITIONS[f"{package}/{name}"] for name in names}
                subprocess.run(
                    [sys.executable, str(BUILDER), str(folder), package, *dependencies],
                    input=json.dumps(definitions), text=True, check=True, stdout=subprocess.DEVNULL,
                    env={**os.environ, "_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
                )  # fmt: skip
            (folder / "made").touch()
    return {"PYTHONPATH": f"{folder}:{ros.ROOT}", "LD_LIBRARY_PATH": str(folder)}


@pytest.fixture
def loop(request):
    """Run a loop with types of a kind; returns how many rounds it did."""

    def loop(code, kind, number, seconds=LOOP_S):
        more = request.getfixturevalue("compiled") if kind == "compiled" else {}
        command = [sys.executable, "-c", BEGIN + code, kind, str(seconds)]
        environment = ros.ros_environment(number, **more)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=seconds + 60)
        assert done.returncode == 0, done.stdout + done.stderr
        return int(done.stdout)

    return loop


#: SIGUSR2 plants a deadlock: the thread waits in a library for ever, with the GIL
PLANTED = """
import ctypes, signal, sys
if "canopen_control.ros.bridge" in sys.orig_argv:
    signal.signal(signal.SIGUSR2, lambda *_: ctypes.PyDLL(None).pause())
"""


@contextlib.contextmanager
def running(folder, *options):
    """Run robby on virtual drives with its bridge."""
    (folder / "sitecustomize.py").write_text(PLANTED)
    with ros.stage(folder, PYTHONPATH=f"{folder}:{ros.ROOT}") as stage:
        config = copy_robby(folder, bus=PATIENT_ROBBY)
        robot = stage.start("run", config, "--ros", "--can", "local:freezes", *options, **stage.environment)
        robot.until("robby runs")
        yield SimpleNamespace(domain=stage.domain, robot=robot, stage=stage)


@pytest.fixture(scope="module")
def robby(tmp_path_factory):
    with running(tmp_path_factory.mktemp("freezes")) as robby:
        yield robby


@pytest.fixture
def hanging(request, tmp_path_factory):
    """A robby whose bridge is a fork, or an interpreter in which a deadlock can be planted: forks keep no handlers."""
    if request.param == signal.SIGSTOP:
        yield request.getfixturevalue("robby")
    else:
        with running(tmp_path_factory.mktemp("planted"), "--spawn") as robby:
            yield robby


@pytest.mark.parametrize("kind", KINDS)
def test_two_threads_publish_on_one_publisher(loop, kind):
    with ros.domain() as number:
        assert loop(PUBLISH, kind, number) > 100 * LOOP_S


@pytest.mark.parametrize("kind", KINDS)
def test_a_program_that_spins_in_a_thread_makes_a_client_for_each_call(loop, kind, robby):
    assert loop(CALL, kind, robby.domain) > 2 * LOOP_S


@pytest.mark.parametrize("kind", KINDS)
def test_controllers_are_loaded_switched_and_unloaded_again_and_again(loop, kind, robby):
    assert loop(CHURN, kind, robby.domain) >= 1


@pytest.mark.parametrize(
    ("hanging", "signal_number"),
    [(signal.SIGSTOP, signal.SIGSTOP), (signal.SIGUSR2, signal.SIGUSR2)],
    ids=["stopped", "planted_deadlock"],
    indirect=["hanging"],
)
def test_a_bridge_that_hangs_is_killed_and_a_new_one_serves(loop, hanging, signal_number):
    assert loop(CALL, "made", hanging.domain, 4) > 0
    restarts = hanging.robot.out.count("process ros: it is restarted")
    pid = hanging.stage.pid_of("canopen_control.ros.bridge")
    os.kill(pid, signal_number)
    hanging.robot.until(f"process ros (pid {pid}) has not answered for")
    assert eventually(lambda: hanging.robot.out.count("process ros: it is restarted") > restarts, 20)
    assert loop(CALL, "made", hanging.domain, 4) > 0
