"""Build hook of the wheel: compiles the modules of the cycle with mypyc, in a copy: nothing is left in the checkout.

It is off unless the environment says HATCH_BUILD_HOOK_ENABLE_CUSTOM=1; else the wheel is py3-none-any. The modules
and the options stand in pyproject.toml. The sources of compiled modules are in the wheel too: tracebacks show their
lines, and type checkers read them.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "canopen_control"
PROGRESS = "HATCH_BUILD_PROGRESS"  # names a file that gets a line for each step: pip shows no output of a build
SETUP = """
import itertools
import json
import os
from concurrent.futures import ThreadPoolExecutor
from distutils.ccompiler import CCompiler
from pathlib import Path

from mypyc.build import mypycify
from setuptools import setup

job = json.loads(Path("job.json").read_text())


def report(text):
    if job["progress"]:
        with open(job["progress"], "a") as file:
            print(text, file=file)


def compile_files(self, sources, output_dir=None, macros=None, include_dirs=None, debug=0, extra_preargs=None,
                  extra_postargs=None, depends=None):
    # one compiler for each processor: those of setuptools run one after the other
    macros, objects, postargs, pp_opts, build = self._setup_compile(
        output_dir, macros, include_dirs, sources, depends, extra_postargs
    )
    args = self._get_cc_args(pp_opts, debug, extra_preargs)
    counter = itertools.count(1)

    def compile_file(name):
        self._compile(name, *build[name], args, postargs, pp_opts)
        if len(build) > 1:
            report(f"compiled {next(counter)} of {len(build)} files")

    largest_first = sorted(build, key=lambda name: -os.path.getsize(build[name][0]))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(compile_file, largest_first))
    return objects


CCompiler.compile = compile_files
report("mypyc translates the modules to C (a minute)")
setup(name="compiled", packages=[], ext_modules=mypycify(job["arguments"], **job["options"]))
"""


class CompiledModules(BuildHookInterface):
    """Adds an extension module for each source that `include` names, beside that source."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, unless the installation is an editable one: that runs the sources."""
        if self.target_name != "wheel" or version == "editable":
            return
        self.folder = tempfile.TemporaryDirectory(prefix="compile-")
        made = Path(self.folder.name, "made")
        self._compile(Path(self.folder.name, "copy"), made)
        build_data["force_include"] |= {str(path): path.relative_to(made).as_posix() for path in made.rglob("*.so")}
        build_data["infer_tag"], build_data["pure_python"] = True, False

    def finalize(self, _version: str, _build_data: dict[str, Any], _artifact_path: str) -> None:
        """Remove the copy, from which the wheel was made."""
        if hasattr(self, "folder"):
            self.folder.cleanup()

    def _compile(self, copy: Path, made: Path) -> None:
        """Compile a copy of the package: the paths that tracebacks show are relative to it."""
        root = Path(self.root)
        sources = [each.lstrip("/") for each in self.config["include"]]
        if missing := [each for each in sources if not (root / each).is_file()]:
            raise FileNotFoundError(f"pyproject.toml has modules compiled that are not there: {', '.join(missing)}")
        ignored = shutil.ignore_patterns("*.so", "*.pyc", "__pycache__")
        shutil.copytree(root / PACKAGE, copy / PACKAGE, ignore=ignored)
        arguments = [*self.config["mypy-args"], *sources]
        job = {"arguments": arguments, "options": self.config["options"], "progress": os.environ.get(PROGRESS)}
        (copy / "job.json").write_text(json.dumps(job))
        (copy / "setup.py").write_text(SETUP)
        command = [sys.executable, "setup.py", "build_ext", "--build-lib", str(made), "--build-temp", "objects"]
        done = subprocess.run(command, cwd=copy, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        if done.returncode:
            raise RuntimeError(f"mypyc failed; the end of what it said:\n{done.stdout[-4000:]}")
