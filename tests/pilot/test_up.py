"""`skyrelay up`: real processes, a chain behind HTTP, a real bus; what comes out is what one process gives."""

import re
import subprocess

from town_of_processes import decided, sets, skyrelay


def test_processes_in_lock_step_decide_what_one_process_decides(run_folder, tmp_path):
    process = skyrelay("up", "--out", tmp_path / "up", *sets(), stderr=subprocess.PIPE, stdout=subprocess.PIPE)
    told, lines = process.communicate(timeout=300)
    assert process.returncode == 0, lines
    one, many = decided(run_folder), decided(tmp_path / "up")
    for table in one:
        assert many[table] == one[table], table
    assert len(re.findall(r"^\w+ +process \d+", lines, re.MULTILINE)) == 4
    assert "3 periods" in told
    assert not list((tmp_path / "up-hosts").glob("*.keystore"))
    audit = skyrelay("audit", tmp_path / "up", stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert audit.wait(120) == 0, audit.stdout.read()
