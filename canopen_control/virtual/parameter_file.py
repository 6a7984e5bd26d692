"""What outlasts the power, in a file: the values of 0x1010, and the node id and bit rate of LSS.

The file is JSON for people to read, one entry for each node by the id it was started with:

    {"format": "canopen_control store 1",
     "nodes": {"3": {"device": [646, 1270], "node_id": 3, "bitrate": null, "values": {"6083:00": "10270000"}}}}

Values are the object's bytes as on the wire. It is replaced as a whole, never written in part; several processes may
share it. What does not fit the dictionary (any more) is ignored and told; another device's entry is refused.
"""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING, Any

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.host.sockets import lock
from canopen_control.od.codec import decode, encode

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.od.model import Address
    from canopen_control.virtual.virtual_node import VirtualNode

__all__ = ["ParameterFile"]

FORMAT = "canopen_control store 1"
_Record = dict[str, Any]  # what is kept of a node; anybody may have edited it


class ParameterFile:
    """The file at `path`, which need not exist; ConfigError for one that is something else.

    `say` takes sentences: what the file holds and no node took, and why a writing did not work.
    """

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self.path, self._say = path, say
        self._nodes = self._read()

    def node_id(self, started_with: int) -> int:
        """Return the node id that LSS stored for the node started with another, or that one."""
        record = self._nodes.get(str(started_with), {})
        found = record.get("node_id", started_with)
        possible = isinstance(found, int) and (1 <= found <= MAX_NODE_ID or found == UNCONFIGURED)
        return int(found) if possible else started_with

    def attach(self, node: VirtualNode, started_with: int) -> None:
        """Give a node what is stored for it, before its power-on, and keep what it stores from now on."""
        key = str(started_with)
        record = self._nodes.get(key)
        if record is not None:
            self._restore(node, record)
        node.on_stored(lambda: self._keep(node, key))

    def _restore(self, node: VirtualNode, record: _Record) -> None:
        device = _device(node)
        if record.get("device") != device:
            raise ConfigError(
                f"{self.path}: what is stored for node {node.node_id} is of device {record.get('device')}, this one is "
                f"{device} (vendor, product); take another --store file"
            )
        if node.lss is not None and isinstance(record.get("bitrate"), int):
            node.lss.stored_bitrate = record["bitrate"]
        values = record.get("values")
        for name, text in values.items() if isinstance(values, dict) else ():
            try:
                address = _address(name)
                entry = node.od[address]
                node.store.power_on[address] = decode(bytes.fromhex(text), entry.data_type)
            except (KeyError, TypeError, ValueError):
                self._say(f"{self.path}: {name} of node {node.node_id} does not fit its EDS and is ignored")

    def _keep(self, node: VirtualNode, key: str) -> bool:
        lss = node.lss
        values = {_name(a): encode(v, node.od[a].data_type).hex() for a, v in sorted(node.store.saved().items())}
        record: _Record = {
            "device": _device(node),
            "node_id": node.node_id if lss is None else lss.stored_node_id,
            "bitrate": None if lss is None else lss.stored_bitrate,
            "values": values,
        }
        try:
            with lock(self.path):
                self._nodes = self._read() | {key: record}
                self._write()
        except (CanopenError, OSError) as error:
            self._say(f"{self.path} cannot be written: {error}")
            return False
        return True

    def _read(self) -> dict[str, _Record]:
        try:
            content = json.loads(self.path.read_bytes())
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise ConfigError(f"{self.path} cannot be read: {error.strerror}") from None
        except ValueError:
            content = None
        nodes = content.get("nodes") if isinstance(content, dict) and content.get("format") == FORMAT else None
        if not isinstance(nodes, dict) or not all(isinstance(record, dict) for record in nodes.values()):
            raise ConfigError(f"{self.path} is no store of virtual drives; name a new file, it will be made")
        return nodes

    def _write(self) -> None:
        new = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        with new.open("w", encoding="utf-8") as file:
            json.dump({"format": FORMAT, "nodes": self._nodes}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)


def _device(node: VirtualNode) -> list[int]:
    return [node.store.number(0x1018, 1), node.store.number(0x1018, 2)]


def _name(address: Address) -> str:
    return f"{address[0]:04X}:{address[1]:02X}"


def _address(name: str) -> Address:
    index, _, subindex = name.partition(":")
    return int(index, 16), int(subindex, 16)
