"""3D Gaussian Splatting training on any OpenCL device: the program `mhsplat`, run from Python.

    import mhsplat

    run = mhsplat.train("photos", output="run", time_budget="10m", max_size=800)
    print(run.final["psnr"], run.record["gaussians"])
    run.viewer()

Options are those of the command line (`mhsplat train --help`), with underscores.
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import threading
import webbrowser
from collections import deque
from pathlib import Path

__all__ = ["Error", "Run", "command", "program", "train"]

# Lines of the program's messages that an error repeats.
_KEPT_LINES = 20


class Error(RuntimeError):
    """A run of the program that failed: `code` is its exit code (2: wrong input), the text its last messages."""

    def __init__(self, code, message):
        super().__init__(message)
        self.code = code


class Run:
    """A run folder.

    `path` is the folder, `scene` its trained Gaussians (PLY).
    """

    def __init__(self, path):
        self.path = Path(path)
        if not (self.path / "run.json").is_file():
            raise FileNotFoundError(f"{self.path}: holds no run (run.json is missing)")

    def __repr__(self):
        return f"Run({str(self.path)!r})"

    @property
    def record(self):
        """The record of the run as a dictionary: configuration, plan, dataset, scores of each view (`run.json`)."""
        return json.loads((self.path / "run.json").read_text(encoding="utf-8"))

    @property
    def final(self):
        """Scores at the end: `psnr` (dB), `ssim`, `flip`, each view's; `None` for a run that was stopped before."""
        return self.record.get("final")

    @property
    def metrics(self):
        """A dictionary per evaluation, in order: `iteration`, `psnr` (dB), `cpu_seconds` and others (`metrics.csv`)."""
        with open(self.path / "metrics.csv", newline="", encoding="utf-8") as rows:
            return [{key: _number(text) for key, text in row.items()} for row in csv.DictReader(rows)]

    @property
    def scene(self):
        """Path of the trained Gaussians."""
        return self.path / "scene.ply"

    def viewer(self, show=True):
        """Path of the page that shows the scene; opened in a browser if `show`."""
        return self._page("scene.html", show)

    def report(self, show=True):
        """Path of the report page; opened in a browser if `show`."""
        return self._page("report.html", show)

    def _page(self, name, show):
        page = self.path / name
        if not page.is_file():
            raise FileNotFoundError(f"{page}: a run that has ended has this page")
        if show:
            webbrowser.open(page.resolve().as_uri())
        return page


def train(dataset, output, **options):
    """Trains a scene and returns its `Run`.

    `dataset` is a folder of photos with cameras, `output` the run folder to be made. An option is given by its name:
    `sh_degree=2` is `--sh-degree 2`; `True` gives the option alone, `False` and `None` leave it out, a list repeats it.
    Messages of the program go to standard error. Raises `Error` where it fails.
    """
    # A run whose Python has gone ends with a checkpoint.
    command("train", dataset, output=output, until_stdin_ends=True, **options)
    return Run(output)


def command(name, *arguments, **options):
    """Runs a command of the program, `mhsplat name …`, and returns what it prints: a document if `json=True`, else text."""
    words = [program(), name, *map(str, arguments)]
    for key, value in options.items():
        option = "--" + key.replace("_", "-")
        values = value if isinstance(value, (list, tuple)) else [value]
        for one in values:
            if one is True:
                words.append(option)
            elif one is not None and one is not False:
                words.append(f"{option}={one}")
    printed = _run(words)
    return json.loads(printed) if options.get("json") is True else printed


def program():
    """Path of the program: `MHSPLAT_PROGRAM` if that is set, else the one installed with this module, else that of `PATH`."""
    named = os.environ.get("MHSPLAT_PROGRAM")
    if named:
        return named
    file = "mhsplat.exe" if os.name == "nt" else "mhsplat"
    schemes = [None, *(s for s in sysconfig.get_scheme_names() if s.endswith("_user"))]
    for scheme in schemes:
        folder = sysconfig.get_path("scripts", scheme) if scheme else sysconfig.get_path("scripts")
        path = Path(folder) / file
        if path.is_file():
            return str(path)
    found = shutil.which("mhsplat")
    if found is None:
        raise FileNotFoundError("the program mhsplat is neither installed with this module nor on PATH")
    return found


def _run(words):
    last = deque(maxlen=_KEPT_LINES)
    # In a session of its own it has an interrupt once, from here, and not from the terminal as well: a second one ends it at once.
    with subprocess.Popen(
        words,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
        errors="replace",
        start_new_session=True,
    ) as child:
        # Documents are printed at the end, when nothing reads standard error any more: a thread takes them.
        printed = []
        reader = _reader(child.stdout, printed)
        try:
            for line in child.stderr:
                last.append(line)
                sys.stderr.write(line)
            reader.join()
            code = child.wait()
        except KeyboardInterrupt:
            # The program saves a checkpoint before it ends.
            child.send_signal(signal.SIGINT)
            try:
                sys.stderr.writelines(child.stderr)
                child.wait()
            except KeyboardInterrupt:
                # A second one does not wait for it.
                child.send_signal(signal.SIGINT)
            raise
    if code != 0:
        raise Error(code, "".join(last).strip() or f"mhsplat ended with exit code {code}")
    return "".join(printed)


def _reader(stream, lines):
    thread = threading.Thread(target=lines.extend, args=(stream,), daemon=True)
    thread.start()
    return thread


def _number(text):
    if text == "":
        return None
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            pass
    return text
