"""The parameters of every controller; those of each kind derive from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from canopen_control.yamlfile.convert import setting

__all__ = ["CommonParams"]


@dataclass(frozen=True)
class CommonParams:
    """The parameters that every controller has; `update_rate` in Hz, 0 is the manager's own."""

    INEFFECTIVE: ClassVar[dict[str, str]] = {
        "is_async": "all controllers run in the cycle, in one thread",
        "thread_priority": "all controllers run in the cycle; run --realtime sets the priority of its thread",
    }

    type: str = ""
    update_rate: int = setting(0, low=0)
    use_sim_time: bool = False
    is_async: bool = False
    thread_priority: int = 50
