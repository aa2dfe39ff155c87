"""Kill a process at every line of the code that replaces a folder, and tell what each left at the place.

``python folder_kills.py DIR exchange|renames`` prints one JSON object for each point, the last with ``"end": true``:
``killed`` is what lay at the place after the kill, ``next`` what lay there once another call had begun and failed, and
``beside`` what was left beside the place then.
"""

import errno
import json
import os
import shutil
import sys
from pathlib import Path

from skyrelay.core import folders

WATCHED = {folders.__file__, shutil.__file__}
PARTS = ("one", "two", "sub/three")


def write(folder, text):
    for part in PARTS:
        (folder / part).parent.mkdir(exist_ok=True)
        (folder / part).write_text(text)


def read(folder):
    """The text that every part has, "absent", or "damaged"."""
    if not folder.exists():
        return "absent"
    texts = {(folder / part).read_text() if (folder / part).exists() else "" for part in PARTS}
    return texts.pop() if len(texts) == 1 and texts != {""} else "damaged"


def replace(place, text, fail=False):
    with folders.new_folder(place, check=lambda _: None) as folder:
        if fail:
            raise InterruptedError
        write(folder, text)


def killed_at(point, place):
    """Whether a process that replaces the folder was killed at its n-th line, or was done before."""
    child = os.fork()
    if not child:
        lines = 0

        def trace(frame, event, _):
            nonlocal lines
            if frame.f_code.co_filename not in WATCHED:
                return None
            if event == "line":
                lines += 1
                if lines == point:
                    os._exit(9)
            return trace

        sys.settrace(trace)
        replace(place, "new")
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9


def main(root, way):
    if way == "renames":

        def refuse(*_):
            raise OSError(errno.EINVAL, "cannot")

        folders._exchange = refuse
    point, running = 0, True
    while running:
        point += 1
        here = root / str(point)
        place = here / "run"
        replace(place, "old")
        running = killed_at(point, place)
        left = read(place)
        try:
            replace(place, "newer", fail=True)
        except InterruptedError:
            after = read(place)
        beside = sorted(path.name for path in here.iterdir() if path != place)
        print(json.dumps({"point": point, "killed": left, "next": after, "beside": beside, "end": not running}))
        shutil.rmtree(here)


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
