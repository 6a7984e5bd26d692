"""The monitor's picture for the README: a robot that drives, after a fault of one drive that is over."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from typing import TYPE_CHECKING

from canopen_control.monitor.monitor_app import MonitorApp
from canopen_control.monitor.sources import LiveRobot

if TYPE_CHECKING:
    from pathlib import Path

SIZE = (124, 30)


def take(path: Path, robot: str, channel: str) -> Path:
    """Watch `robot`, which runs robby on `channel`, break its left drive, mend it, drive, and write the SVG."""
    asyncio.run(_take(path, robot, channel))
    return path


async def _take(path: Path, robot: str, channel: str) -> None:
    app = MonitorApp(LiveRobot(robot))
    async with app.run_test(size=SIZE) as pilot:
        for line in (
            f"fault 3 drive_fault on --can {channel}",
            f"fault 3 drive_fault off --can {channel}",
            f"axis fault-reset all --name {robot}",
            f"axis enable all --name {robot}",
        ):
            await pilot.pause(0.6)
            await asyncio.to_thread(_call, line.split())
        command = ["command", "robby_forward_controller", "8", "6", "--name", robot]
        with subprocess.Popen([sys.executable, "-m", "canopen_control", *command]) as driving:
            await pilot.pause(2.5)
            picture = app.picture_svg()
            driving.terminate()
        path.write_text(picture, encoding="utf-8")


def _call(arguments: list[str]) -> None:
    subprocess.run([sys.executable, "-m", "canopen_control", *arguments], check=True, stdout=subprocess.DEVNULL)
