import pytest

from skyrelay.core.errors import RunFolderError
from skyrelay.runfolder import new_run_folder


def fill(path, text="{}", replace=False):
    with new_run_folder(path, replace) as folder:
        (folder / "summary.json").write_text(text)


def test_a_failed_run_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), new_run_folder(tmp_path / "run") as folder:
        _interrupted(folder)
    assert list(tmp_path.iterdir()) == []


def _interrupted(folder):
    (folder / "half").write_text("half")
    raise KeyboardInterrupt


def test_a_failed_replacement_keeps_the_old_run(tmp_path):
    fill(tmp_path / "run", "old")
    with pytest.raises(KeyboardInterrupt), new_run_folder(tmp_path / "run", replace=True) as folder:
        _interrupted(folder)
    assert (tmp_path / "run" / "summary.json").read_text() == "old"


def test_a_run_is_replaced_only_when_asked_for(tmp_path):
    fill(tmp_path / "run", "old")
    with pytest.raises(RunFolderError, match="--force"):
        fill(tmp_path / "run")
    fill(tmp_path / "run", "new", replace=True)
    assert (tmp_path / "run" / "summary.json").read_text() == "new"


def test_what_is_no_run_folder_is_never_replaced(tmp_path):
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").write_text("dear")
    with pytest.raises(RunFolderError, match="no run folder"):
        fill(tmp_path / "thesis", replace=True)
    assert (tmp_path / "thesis" / "chapter.tex").read_text() == "dear"
    with pytest.raises(RunFolderError):
        fill(tmp_path / "thesis" / "chapter.tex", replace=True)
