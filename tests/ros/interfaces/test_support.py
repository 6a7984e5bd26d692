from __future__ import annotations

import ctypes
import hashlib
import platform
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ros import Peer, domain, ros_environment, run_ros

from canopen_control.ros.interfaces import support
from canopen_control.ros.interfaces.cdr import Codecs
from canopen_control.ros.interfaces.definition import Registry
from canopen_control.ros.interfaces.support import Callbacks, Supports

FOLDER = Path(support.__file__).parent


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_the_library_of_each_processor_is_made_of_the_source_next_to_it(processor):
    digest = hashlib.sha256((FOLDER / "callbacks.c").read_bytes()).hexdigest()
    assert digest.encode() in (FOLDER / f"callbacks_{processor}.so").read_bytes(), "run tools/native_callbacks"


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_the_library_needs_no_other_and_allows_no_code_on_the_stack(processor):
    held = (FOLDER / f"callbacks_{processor}.so").read_bytes()
    assert b"libc.so" not in held
    header, count = int.from_bytes(held[32:40], "little"), int.from_bytes(held[56:58], "little")
    segments = [held[header + 56 * number :][:56] for number in range(count)]
    kinds = {int.from_bytes(segment[:4], "little"): int.from_bytes(segment[4:8], "little") for segment in segments}
    assert kinds[0x6474E551] & 1 == 0  # PT_GNU_STACK without PF_X


def test_a_processor_without_a_library_is_reported_with_what_to_make_one(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(
        OSError, match=r"callbacks_riscv64\.so is missing .* build it with: cc -O2 -shared -fPIC -o .*callbacks\.c"
    ):
        support.Callbacks(0, 0, 0, 0)


def test_the_number_of_types_is_limited_and_one_more_is_refused():
    callbacks = support.Callbacks(0, 0, 0, 0)
    created = {callbacks.deserializer(f"p/msg/T{number}", 0) for number in range(support.SLOTS)}
    assert len(created) == support.SLOTS
    with pytest.raises(RuntimeError, match="more than 512 types"):
        callbacks.deserializer("p/msg/Last", 0)


def test_a_support_of_a_kind_is_found_by_its_name():
    callbacks = support.Callbacks(0, 0, 0, 0)
    names = [ctypes.create_string_buffer(item) for item in (b"one", b"another", b"anoth")]
    supports = [support.MessageSupport(ctypes.addressof(name)) for name in names]
    where = [ctypes.addressof(item) for item in supports]
    supports[0].kinds[:] = where
    find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(callbacks["message_of_kind"])
    assert [find(where[0], item) for item in (b"one", b"another", b"anoth", b"ano", b"")] == [*where, None, None]


@pytest.mark.ros
def test_a_body_goes_into_a_message_in_c_and_out_again():
    code = """
import ctypes, rclpy.serialization
from canopen_control.ros.interfaces.support import Libraries
support = Libraries()
message = ctypes.CFUNCTYPE(ctypes.c_void_p)(support.create)()
assert support.body_of(message) == b""
assert support.set_body(message, b"a\\0b")
assert support.body_of(message) == b"a\\0b"
ctypes.CFUNCTYPE(None, ctypes.c_void_p)(support.destroy)(message)
assert all((support.fast_id, support.introspection_id, support.dispatch_id))
"""
    assert run_ros(code) == ""


DEFINITIONS_OF_WHOLE = {
    "p/msg/Empty": [],
    "p/msg/Point": ["uint8 a", "float64 x"],
    "p/msg/All": [
        "bool yes", "byte one", "int16 middle", "float64 double", "string text", "float64[] numbers", "uint8[3] three",
        "string[] texts", "bool[] flags", "Point[2] pair", "Point[] points", "Empty nothing", "Empty[] nothings",
        "int16[<=2] two", "string<=5 short",
    ],
}  # fmt: skip
POSITION, ASSIGN = (
    ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p),
    ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t),
)
DESERIALIZE = ctypes.CFUNCTYPE(ctypes.c_bool, ctypes.c_void_p, ctypes.c_void_p)


class Native:
    """`callbacks.c` as Fast DDS calls it, over a Cdr that is two pointers, and what it takes as `taken`."""

    def __init__(self, name="p/msg/All", definitions=DEFINITIONS_OF_WHOLE):
        registry = Registry()
        registry.add(definitions)
        self.name, self.codecs, self.taken = name, Codecs(registry.get, lambda _: SimpleNamespace), []
        self._position = POSITION(lambda cdr: ctypes.c_size_t.from_address(cdr).value)
        self._assign = ASSIGN(self._take)
        position, assign = (ctypes.cast(item, ctypes.c_void_p).value for item in (self._position, self._assign))
        self.callbacks = Callbacks(0, position, assign, end_offset=8)
        supports = Supports(SimpleNamespace(callbacks=self.callbacks), registry, self.codecs)
        self._deserialize = DESERIALIZE(self.callbacks.deserializer(name, supports._layout(name)))

    def _take(self, _message, data, size):
        self.taken.append(ctypes.string_at(data, size))
        return True

    def takes(self, body, header=b"\0\1\0\0"):
        held = ctypes.create_string_buffer(header + body, len(header + body))
        start = ctypes.addressof(held) + len(header)
        cdr = (ctypes.c_size_t * 2)(start, start + len(body))
        return self._deserialize(ctypes.addressof(cdr), 0)

    def decodes(self, body):
        try:
            self.codecs.decode(self.name, body)
        except ValueError:
            return False
        return True


def message(**changes):
    held = SimpleNamespace(
        yes=True, one=b"a", middle=-2, double=0.5, text="grün", numbers=[1.0], three=[1, 2, 3], texts=["", "ab"],
        flags=[True], pair=[SimpleNamespace(a=1, x=2.0)] * 2, points=[SimpleNamespace(a=1, x=2.0)] * 3,
        nothing=SimpleNamespace(), nothings=[SimpleNamespace()], two=[1], short="abc",
    )  # fmt: skip
    vars(held).update(changes)
    return held


def test_what_comes_is_taken_as_it_is_and_what_follows_it_too():
    native = Native()
    body = native.codecs.encode("p/msg/All", message())
    assert native.takes(body)
    assert native.takes(body + b"more")
    assert native.taken == [body, body + b"more"]
    assert native.callbacks.newly_dropped() == []


def test_every_body_that_is_cut_is_dropped_and_reported_once():
    native = Native()
    body = native.codecs.encode("p/msg/All", message())
    assert not any(native.takes(body[:length]) for length in range(len(body)))
    assert native.callbacks.newly_dropped() == ["p/msg/All"]
    assert native.callbacks.newly_dropped() == []


@given(st.binary(max_size=120))
def test_c_and_python_judge_the_same_garbage_alike(body):
    native = Native()
    assert native.takes(body) == native.decodes(body)


@given(st.data())
def test_c_and_python_judge_a_message_with_wrong_bytes_alike(data):
    native = Native()
    body = bytearray(native.codecs.encode("p/msg/All", message()))
    for _ in range(data.draw(st.integers(1, 3))):
        body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.sampled_from([0, 1, 2, 127, 255]))
    assert native.takes(bytes(body)) == native.decodes(bytes(body))


@pytest.mark.parametrize("kind", ["float64[]", "string[]", "bool[]", "Point[]", "string"])
def test_a_length_of_four_gigabytes_is_dropped(kind):
    native = Native("p/msg/T", {**DEFINITIONS_OF_WHOLE, "p/msg/T": [f"{kind} values"]})
    assert not native.takes(b"\xff" * 8)
    assert native.takes(b"\1\0\0\0" + bytes(32))


@given(st.binary(max_size=12))
def test_text_that_is_not_a_utf_8_is_a_message_all_the_same(text):
    native = Native("p/msg/T", {"p/msg/T": ["string text"]})
    body = (len(text) + 1).to_bytes(4, "little") + text + b"\0"
    assert native.takes(body)
    assert native.codecs.decode("p/msg/T", body).text == text.decode("utf-8", "replace")


MIRROR = '''
"""Every message of the installed packages, made again under its own name: ours against the compiled one."""
import json, random, sys, array
from pathlib import Path
import importlib, numpy
from rclpy.serialization import serialize_message, deserialize_message
from canopen_control.ros.interfaces.cdr import Codecs
from canopen_control.ros.interfaces.definition import Registry
from canopen_control.ros.interfaces.definition import parts_of
share = Path(sys.prefix, "share")
registry = Registry([share])
def class_of(name):
    package, kind, short = parts_of(name)
    return getattr(importlib.import_module(f"{package}.{kind}"), short)
codecs = Codecs(registry.get, class_of)
chance = random.Random(7)
INTS = {2: (-128, 127), 3: (0, 255), 4: (-2**15, 2**15 - 1), 5: (0, 2**16 - 1), 6: (-2**31, 2**31 - 1),
        7: (0, 2**32 - 1), 8: (-2**63, 2**63 - 1), 9: (0, 2**64 - 1)}
def scalar(kind):
    if kind.base == 1: return fill(kind.nested)
    if kind.base in INTS: return chance.randint(*INTS[kind.base])
    if kind.base == 10: return float(numpy.float32(chance.uniform(-1e6, 1e6)))
    if kind.base == 11: return chance.uniform(-1e6, 1e6)
    if kind.base == 15: return chance.random() < 0.5
    if kind.base == 16: return bytes([chance.randrange(256)])
    return "".join(chance.choice("aä€ 0") for _ in range(chance.randrange(9)))
def fill(name):
    message = class_of(name)()
    for field in registry.get(name).fields:
        kind = field.type
        if field.name.startswith("structure_needs"): continue
        if kind.shape == 0: setattr(message, field.name, scalar(kind)); continue
        count = kind.capacity if kind.shape == 1 else chance.randrange(4)
        values = [scalar(kind) for _ in range(count)]
        if kind.shape == 1 and kind.base in (*INTS, 10, 11):
            values = numpy.array(values, dtype=getattr(message, field.name).dtype)
        setattr(message, field.name, values)
    return message
def same(one, other):
    for field in one.get_fields_and_field_types():
        a, b = getattr(one, field), getattr(other, field)
        if hasattr(a, "get_fields_and_field_types"):
            if not same(a, b): return False
        elif isinstance(a, list) and a and hasattr(a[0], "get_fields_and_field_types"):
            if len(a) != len(b) or not all(map(same, a, b)): return False
        elif hasattr(a, "__len__") and not isinstance(a, (str, bytes)):
            if list(a) != list(b): return False
        elif a != b: return False
    return True
count = 0
for path in sorted(share.glob("*_msgs/msg/*.json")):
    name = json.loads(path.read_text())["type_description_msg"]["type_description"]["type_name"]
    structures = (registry.get(name), *registry.referenced(name))
    if any(each.type.base in (18, 22, 12, 13, 14) for structure in structures for each in structure.fields): continue
    for _ in range(3):
        message = fill(name)
        assert same(deserialize_message(b"\\0\\1\\0\\0" + codecs.encode(name, message), class_of(name)), message), name
        assert same(codecs.decode(name, serialize_message(message)[4:]), message), name
    count += 1
print(count)
'''


@pytest.mark.ros
def test_random_messages_of_every_installed_type_are_the_same_in_our_code_and_in_the_compiled_one():
    assert int(run_ros(MIRROR)) > 100


@pytest.mark.ros
def test_made_messages_and_services_work_between_two_processes():
    with domain() as number, Peer(number, "--interfaces") as one, Peer(number, "--interfaces") as other:
        transforms = [
            {"header": {"frame_id": "odom"}, "child_frame_id": "base_link", "transform": {"translation": {"x": 1.5}}}
        ]
        other.order("subscribe", topic="/tf", of="tf2_msgs/msg/TFMessage")
        one.order("publish", topic="/tf", of="tf2_msgs/msg/TFMessage", data={"transforms": transforms}, rate=20)
        (transform,) = other.message("/tf")["transforms"]
        assert (transform["header"]["frame_id"], transform["child_frame_id"]) == ("odom", "base_link")
        assert transform["transform"]["translation"] == {"x": 1.5, "y": 0.0, "z": 0.0}
        assert transform["transform"]["rotation"]["w"] == 1.0
        publisher = other.publisher("/tf")
        assert publisher["hash"] == "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"


@pytest.mark.ros
def test_a_body_that_is_none_raises_instead_of_giving_a_message():
    code = """
from canopen_control.ros.interfaces import provide
provide(["canopen_interfaces"])
from canopen_interfaces.msg import COData
from rclpy.serialization import deserialize_message, serialize_message
body = serialize_message(COData(index=0x6040, subindex=1, data=7))
assert deserialize_message(body, COData) == COData(index=0x6040, subindex=1, data=7)
for bad in (lambda: deserialize_message(body[:8], COData), lambda: serialize_message(COData(index=-1))):
    try:
        bad()
    except Exception:
        continue
    raise SystemExit("accepted")
"""
    assert run_ros(code) == ""


@pytest.mark.ros
def test_service_introspection_works_with_made_services():
    code = """
import rclpy, time
from canopen_control.ros.interfaces import provide
provide(["canopen_interfaces"])
from canopen_interfaces.srv import CORead
from rclpy.qos import QoSProfile
from rclpy.service_introspection import ServiceIntrospectionState
rclpy.init()
node = rclpy.create_node("n")
def read(request, response):
    response.success, response.data = True, request.index + 1
    return response
service = node.create_service(CORead, "sdo_read", read)
service.configure_introspection(node.get_clock(), QoSProfile(depth=10), ServiceIntrospectionState.CONTENTS)
events = []
node.create_subscription(CORead.Event, "sdo_read/_service_event", events.append, 10)
client = node.create_client(CORead, "sdo_read")
assert client.wait_for_service(20)
future = client.call_async(CORead.Request(index=0x6041))
deadline = time.monotonic() + 20
while (not future.done() or len(events) < 2) and time.monotonic() < deadline:
    rclpy.spin_once(node, timeout_sec=0.1)
assert future.result() == CORead.Response(success=True, data=0x6042)
assert [each.request[0].index for each in events if each.request] == [0x6041]
assert [each.response[0].data for each in events if each.response] == [0x6042]
"""
    with domain() as number:
        assert run_ros(code, number) == ""


@pytest.mark.ros
def test_an_installed_package_is_never_replaced(tmp_path):
    package = tmp_path / "tf2_msgs" / "msg"
    package.mkdir(parents=True)
    (tmp_path / "tf2_msgs" / "__init__.py").touch()
    (package / "__init__.py").write_text("TFMessage = 'the real one'")
    code = """
import sys
sys.path.insert(0, sys.argv[1])
from canopen_control.ros.interfaces import provide
assert provide(["tf2_msgs", "canopen_interfaces"]) == ["canopen_interfaces"]
assert provide(["tf2_msgs", "canopen_interfaces"]) == []
from tf2_msgs.msg import TFMessage
assert TFMessage == "the real one"
import importlib.util
assert importlib.util.find_spec("canopen_interfaces.srv") is not None
"""
    assert run_ros(code, arguments=[str(tmp_path)]) == ""


@pytest.mark.ros
def test_a_ros_that_is_laid_out_in_another_way_is_reported_in_one_sentence():
    code = """
from canopen_control.errors import CanopenError
from canopen_control.ros import interfaces
from canopen_control.ros.interfaces import support
support._BUFFER_MADE = "another_name"
try:
    interfaces.provide(["tf2_msgs"])
except CanopenError as error:
    print(error)
"""
    assert run_ros(code).startswith("no interfaces can be created for this ROS: ")


STRANGERS = """
import sys, threading, time
from canopen_control.ros import interfaces, rcl
if sys.argv[1] == "stranger":
    interfaces.DEFINITIONS["canopen_interfaces/srv/COWrite"] = ["uint8 a", "---", "bool success"]
    interfaces.DEFINITIONS["control_msgs/action/FollowJointTrajectory"] = ["uint8 a", "---", "---"]
interfaces.provide(["canopen_interfaces", "control_msgs"])
from canopen_interfaces.srv import COWrite
from control_msgs.action import FollowJointTrajectory as Follow
from rclpy.action import ActionClient, ActionServer
context, node = rcl.start(sys.argv[1], "", [])
executor = rcl.single_threaded_executor(context)
executor.add_node(node)
def spin_until(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)  # what a callback raises ends the process
    return condition()
if sys.argv[1] == "server":
    written, followed = [], []
    def write(request, response):
        written.append(request.data)
        return response
    def follow(handle):
        followed.append(list(handle.request.trajectory.joint_names))
        handle.succeed()
        return Follow.Result()
    node.create_service(COWrite, "sdo_write", write)
    server = ActionServer(node, Follow, "follow", follow)
    print("ready", flush=True)
    assert spin_until(lambda: written and followed, 20)
    spin_until(lambda: False, 0.2)
    assert (written, followed) == ([7], [["a"]]), (written, followed)
    server.destroy()
else:
    friend = sys.argv[1] == "friend"
    service, action = node.create_client(COWrite, "sdo_write"), ActionClient(node, Follow, "follow")
    assert service.wait_for_service(20) and action.wait_for_server(20)
    goal = Follow.Goal()
    if friend:
        goal.trajectory.joint_names = ["a"]
    request = COWrite.Request(index=0x6040, data=7) if friend else COWrite.Request(a=1)
    answers = [service.call_async(request), action.send_goal_async(goal)]
    answered = spin_until(lambda: all(each.done() for each in answers), 60 if friend else 0.5)
    assert answered == friend
    action.destroy()
executor.shutdown()
context.shutdown()
"""


@pytest.mark.ros
def test_an_image_with_another_layout_is_dropped_and_ends_no_process():
    with domain() as number:
        server = subprocess.Popen(
            [sys.executable, "-c", STRANGERS, "server"], env=ros_environment(number),
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        try:
            assert server.stdout.readline() == "ready\n"
            run_ros(STRANGERS, number, ["stranger"])
            run_ros(STRANGERS, number, ["friend"])
            _, complaints = server.communicate(timeout=60)
        finally:
            server.kill()
            server.communicate()
        assert server.returncode == 0, complaints
        for name in ("canopen_interfaces/srv/COWrite_Request", "control_msgs/action/FollowJointTrajectory_SendGoal"):
            assert f"{name}" in complaints
        assert "dropped a message with another layout" in complaints


BOTH_WAYS = """
import rclpy, sys
from canopen_control.ros.interfaces import _factory
from canopen_control.ros.interfaces.classes import message_class
import std_msgs.msg
factory, name = _factory(), "std_msgs/msg/Float64MultiArray"
made = message_class(factory.registry.get(name), factory.class_of, factory.supports)
assert made is not std_msgs.msg.Float64MultiArray
rclpy.init()
node = rclpy.create_node("maker")
publisher, got = node.create_publisher(made, "/from_made", 10), []
node.create_subscription(made, "/from_compiled", got.append, 10)
message = made(data=[1.5, -2.5])
for _ in range(400):
    publisher.publish(message)
    rclpy.spin_once(node, timeout_sec=0.05)
    if got and publisher.get_subscription_count():
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.2)
        break
print(list(got[0].data))
"""


@pytest.mark.ros
def test_a_class_made_at_run_time_talks_to_a_compiled_one_in_another_process_both_ways():
    name = "std_msgs/msg/Float64MultiArray"
    with domain() as number, Peer(number) as compiled:
        compiled.order("subscribe", topic="/from_made", of=name)
        compiled.order("publish", topic="/from_compiled", of=name, data={"data": [3.0, 4.0]}, rate=20)
        assert run_ros(BOTH_WAYS, number) == "[3.0, 4.0]\n"
        assert compiled.message("/from_made")["data"] == [1.5, -2.5]


@pytest.mark.ros
def test_a_service_made_at_run_time_serves_a_compiled_client_and_calls_a_compiled_server():
    code = """
import rclpy
from canopen_control.ros.interfaces import _factory
from canopen_control.ros.interfaces.classes import message_class, service_class
import std_srvs.srv
factory, name = _factory(), "std_srvs/srv/SetBool"
factory.registry.add({name: ["bool data", "---", "bool success", "string message"]})
parts = {part: message_class(factory.registry.get(f"{name}_{part}"), factory.class_of, factory.supports)
         for part in ("Request", "Response", "Event")}
made = service_class(name, parts, factory.supports)
rclpy.init()
node = rclpy.create_node("maker")
def answer(request, response):
    response.success, response.message = request.data, "made"
    return response
node.create_service(made, "/made", answer)
client = node.create_client(made, "/compiled")
future = None
for _ in range(400):
    rclpy.spin_once(node, timeout_sec=0.05)
    if future is None and client.service_is_ready():
        future = client.call_async(made.Request(data=True))
    if future is not None and future.done():
        break
print(future.result().success, future.result().message, flush=True)
for _ in range(40):
    rclpy.spin_once(node, timeout_sec=0.05)
"""
    other = """
import rclpy, std_srvs.srv
rclpy.init()
node = rclpy.create_node("compiled")
def answer(request, response):
    response.success, response.message = request.data, "compiled"
    return response
node.create_service(std_srvs.srv.SetBool, "/compiled", answer)
client = node.create_client(std_srvs.srv.SetBool, "/made")
future = None
for _ in range(400):
    rclpy.spin_once(node, timeout_sec=0.05)
    if future is None and client.service_is_ready():
        future = client.call_async(std_srvs.srv.SetBool.Request(data=True))
    if future is not None and future.done():
        break
print(future.result().success, future.result().message, flush=True)
for _ in range(40):
    rclpy.spin_once(node, timeout_sec=0.05)
"""
    with domain() as number:
        process = subprocess.Popen(
            [sys.executable, "-c", other], env=ros_environment(number), stdout=subprocess.PIPE, text=True
        )
        try:
            assert run_ros(code, number) == "True compiled\n"
        finally:
            output, _ = process.communicate(timeout=60)
        assert output == "True made\n"
