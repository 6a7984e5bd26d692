"""Finds the files that a bus.yml names (EDS, DCF, configuration files), and reads each once.

A file is sought in the node's dcf_path, the file's, beside bus.yml and among the bundled ones, in
this order; `@BUS_CONFIG_PATH@` is the folder of bus.yml, `$NAMES` are those of the environment. One EDS serves all
nodes that name it.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.concise import concise_of, decode_concise
from canopen_control.od.eds import read_eds

if TYPE_CHECKING:
    from canopen_control.od.eds import EdsFile
    from canopen_control.od.issues import Issue
    from canopen_control.od.model import ObjectDictionary

__all__ = ["NotFound", "Sources"]

BUS_FOLDER = "@BUS_CONFIG_PATH@"  # replaced by the other stack's build; here the folder of the file itself
_TEXT_FILES = (".dcf", ".eds")


class NotFound(ConfigError):
    """A file is in none of the places; the message names them."""


class Sources:
    """The files of one bus.yml in `folder`; `issues` is what was odd about each EDS that was read."""

    def __init__(self, folder: Path, dcf_path: str = "") -> None:
        self._folder, self._dcf_path = folder, dcf_path
        self._files: dict[Path, EdsFile] = {}
        self._dictionaries: dict[tuple[Path, int | None], ObjectDictionary] = {}
        self.issues: dict[Path, list[Issue]] = {}

    def expanded(self, text: str) -> str:
        """Return the text with the folder of bus.yml and the environment's variables put in."""
        return os.path.expandvars(text.replace(BUS_FOLDER, str(self._folder)))

    def find(self, name: str, dcf_path: str = "") -> Path:
        """Return the path of a file; raises NotFound with the places and with variables that are not set."""
        wanted = Path(self.expanded(name)).expanduser()
        folders = [Path(self.expanded(text)).expanduser() for text in (dcf_path, self._dcf_path) if text]
        places = [folder / wanted for folder in [*folders, self._folder]]
        places.append(data_path("eds", wanted.name))
        for place in places:
            if place.is_file():
                return place
        sought = ", ".join(dict.fromkeys(str(place.parent) for place in places))
        unset = "; a variable of the environment is not set" if "$" in sought or "$" in str(wanted) else ""
        raise NotFound(f"no file {name!r}; sought in {sought}{unset}")

    def dictionary(self, path: Path, node_id: int | None) -> ObjectDictionary:
        """Return the dictionary of an EDS or DCF for a node; None stands for the file's own node id. EdsError."""
        if (path, node_id) not in self._dictionaries:
            if path not in self._files:
                self._files[path] = read_eds(path)
                self.issues[path] = self._files[path].issues
            od = self._files[path].od
            self._dictionaries[path, node_id] = od if node_id is None else od.for_node(node_id)
        return self._dictionaries[path, node_id]

    def downloads(self, name: str, dcf_path: str, node_id: int) -> tuple[tuple[int, int, bytes], ...]:
        """Return what a concise DCF (.bin) or the ParameterValues of a DCF download: (index, subindex, data).

        Those of a DCF come by rising address, which is no order for PDO parameters. ValueError, EdsError, NotFound.
        """
        path = self.find(name, dcf_path)
        if path.suffix.lower() in _TEXT_FILES:
            return tuple(concise_of(self.dictionary(path, node_id)))
        try:
            return tuple(decode_concise(path.read_bytes()))
        except OSError as error:
            raise ValueError(f"cannot be read: {error.strerror}") from error
