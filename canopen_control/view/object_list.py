"""Rows, values and search of a node's objects for the page, without NiceGUI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.commissioning.object_rows import (
    LiveObject,
    axis_word,
    bits_of,
    limit_words,
    rows_of,
    select_objects,
    why_fixed,
)
from canopen_control.errors import ConfigError
from canopen_control.od.model import SCALAR_CODES

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from canopen_control.od.model import Address, Entry, ObjectDictionary
    from canopen_control.view.elements.nicegui_elements import ObjectWords, TreeRow


_MODE = (0x6061, 0)


def address_text(address: Address) -> str:
    """Return an address as text for the page, such as 0x1018:01."""
    return f"0x{address[0]:04X}:{address[1]:02X}"


class ObjectList:
    """Objects of a node for one page, with a record of the values sent to the page."""

    def __init__(self, od: ObjectDictionary, node_id: int) -> None:
        self._od, self._node_id = od, node_id
        self._entries = {address_text(entry.address): entry for entry in select_objects(od, ())}
        self._sent = 0

    @property
    def rows(self) -> list[TreeRow]:
        """Rows of all objects, sorted by address."""
        entries = list(self._entries.values())
        rows = rows_of(self._od, [LiveObject(entry) for entry in entries], self._node_id)
        return [
            {
                "a": address_text(entry.address),
                "index": entry.index,
                "sub": bool(record := self._record(entry)),
                "object": record,
                "name": entry.name if record else row.name,
                "type": row.type,
                "access": row.access,
                "mappable": row.mappable,
                "unit": row.unit,
                "default": row.default,
                "limits": limit_words(entry),
                "fixed": why_fixed(entry),
            }
            for entry, row in zip(entries, rows, strict=True)
        ]

    def _record(self, entry: Entry) -> str:
        info = self._od.objects.get(entry.index)
        return "" if info is None or info.code in SCALAR_CODES else info.name or f"0x{entry.index:04X}"

    def entry(self, address: str) -> Entry | None:
        """Return the entry at an address such as 0x1018:01, or None."""
        return self._entries.get(address)

    def entries(self, addresses: Iterable[str]) -> list[Entry]:
        """Return the entries at these addresses; unknown addresses are ignored."""
        return [self._entries[address] for address in addresses if address in self._entries]

    def entries_with_mode(self, addresses: Iterable[str]) -> list[Entry]:
        """Return these entries, plus 0x6061 if the bit names of a statusword or controlword depend on the mode."""
        selected = self.entries(addresses)
        mode = self._entries.get(address_text(_MODE))
        has_axis = any(axis_word(entry.index) for entry in selected)
        return [*selected, mode] if has_axis and mode is not None and mode not in selected else selected

    def search(self, text: str) -> tuple[list[str] | None, str]:
        """Return the addresses of the objects that match `text`, and an error text.

        The addresses are None for an empty `text`, which matches all objects; the error text is "" without an error.
        """
        if not (words := text.split()):
            return None, ""
        try:
            return [address_text(entry.address) for entry in select_objects(self._od, words)], ""
        except ConfigError as error:
            return [], str(error)

    def news(self, live: Mapping[Address, tuple[int, LiveObject]]) -> dict[str, ObjectWords]:
        """Return the values that have changed since the last call, by address."""
        since, self._sent = self._sent, max((number for number, _ in live.values()), default=self._sent)
        return self._words(live, [value for number, value in live.values() if number > since])

    def known(self, live: Mapping[Address, tuple[int, LiveObject]], addresses: Iterable[str]) -> dict[str, ObjectWords]:
        """Return the known values of these objects, by address."""
        present = [self._entries[address].address for address in addresses if address in self._entries]
        return self._words(live, [live[address][1] for address in present if address in live])

    def _words(
        self, live: Mapping[Address, tuple[int, LiveObject]], objects: list[LiveObject]
    ) -> dict[str, ObjectWords]:
        mode = live[_MODE][1].value if _MODE in live else None
        known_mode = mode if isinstance(mode, int) else None
        rows = rows_of(self._od, objects, self._node_id)
        return {
            address_text(entry.entry.address): {
                "value": row.value,
                "meaning": row.meaning,
                "changed": row.changed,
                "error": row.error,
                "bits": [(bit, name, on) for bit, name, on in bits_of(*entry.entry.address, entry.value, known_mode)],
            }
            for entry, row in zip(objects, rows, strict=True)
        }
