"""What a drive held before somebody changed it, as a DCF in the user's state folder that outlasts this process.

A drive is known by vendor, product and serial number, one without serial number by the bus or robot that it is on. The
file is a backup like any other, so `restore` takes it as well.
"""

from __future__ import annotations

import os
import re
from dataclasses import replace
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.files import state_dir, write_whole
from canopen_control.service.parameter_set import ParameterSet, backup_text, lost_in_text, read_backup

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.od.model import Address, ObjectDictionary, Value
    from canopen_control.service.node_session import NodeSession
    from canopen_control.service.parameter_set import DeviceIdentity

__all__ = ["KeptParameters"]


class KeptParameters:
    """The file of the node of `session` in a folder of the state folder; `channel` is where it was reached."""

    def __init__(self, folder: str, session: NodeSession, identity: DeviceIdentity, channel: str = "") -> None:
        self._session, self._identity = session, identity
        numbers = (identity.vendor, identity.product, identity.serial)
        device = "-".join("none" if number is None else f"{number:08X}" for number in numbers)
        place = "" if identity.serial else f"-{re.sub(r'[^A-Za-z0-9_.]+', '_', session.robot or channel)}"
        self.path = state_dir(folder) / f"node{session.node_id}-{device}{place}.dcf"

    @property
    def parameters(self) -> ParameterSet | None:
        """What is kept, None: nothing."""
        return read_backup(self.path, self._session.node_id) if self.path.is_file() else None

    def read(self) -> Mapping[Address, Value]:
        """Return the values that are kept."""
        kept = self.parameters
        return {} if kept is None else kept.values

    def keep(self, od: ObjectDictionary, values: Mapping[Address, Value]) -> None:
        """Keep values instead of those before; ConfigError where that cannot be."""
        session = self._session
        known = {address: value for address, value in values.items() if address in od}
        parameters = ParameterSet(od, session.node_id, self._identity, known, str(session))
        text = backup_text(parameters)
        if lost := lost_in_text(parameters, text):  # text that no DCF can hold
            kept = {address: value for address, value in known.items() if address not in lost}
            text = backup_text(replace(parameters, values=kept))
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self.path, text.encode())
            with self.path.open("rb") as file:
                os.fsync(file.fileno())
        except (OSError, CanopenError) as error:
            raise ConfigError(
                f"{session}: what it holds cannot be kept in {self.path}, so nothing was written into it: {error}; set "
                "XDG_STATE_HOME to a folder of yours"
            ) from None

    def forget(self) -> None:
        """Keep nothing any more."""
        self.path.unlink(missing_ok=True)
