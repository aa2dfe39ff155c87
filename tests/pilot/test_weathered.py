"""What happens to the network: beacons lost or late, a fleet cut in two, an endpoint that is gone, UAVs away."""

import re
import select
import signal
import socket
import threading

import pytest
from town_of_processes import Up, audited, decided, once

pytestmark = pytest.mark.survival

ALL = 0.999999  # all but one beacon in a million


@pytest.mark.parametrize(
    ("loss", "delay", "hosts"),
    [(0.3, 0.0, 1), (0.0, 1.0, 1), (ALL, 0.0, 2)],
    ids=["30 % lost", "1 s late", "cut in two"],
)
def test_lost_and_late_beacons_move_uavs_and_no_selection(run_folder, tmp_path, loss, delay, hosts):
    """Cut in two: neither of two UAV hosts hears the other, nor the vehicles. What is on the chain is as ever."""
    up = Up(tmp_path / "up", options=["--elsewhere", "uav", "--uav-hosts", hosts])
    names = ["uavs"] if hosts == 1 else [f"uavs-{number + 1}" for number in range(hosts)]
    try:
        for name in names:
            up.start(name, lambda text: text.replace("[bus]", f"[bus]\nloss = {loss}\ndelay = {delay}"))
        up.end()
    finally:
        up.stop()
    one, many = decided(run_folder), decided(up.folder)
    once(many)
    assert [row for row in many["proposals"] if row["period"] == 0] == [
        row for row in one["proposals"] if row["period"] == 0
    ]
    assert {row["period"] for row in many["proposals"] if row["accepted"]} == {0, 1, 2}
    audited(up.folder)


class Way:
    """A way to the chain that can be cut: what comes in at one port goes to another."""

    def __init__(self, port):
        self._to, self._server = port, socket.create_server(("127.0.0.1", 0))
        self.port, self.carried, self._open = self._server.getsockname()[1], 0, []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for one in self._open:
            one.close()

    def _accept(self):
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._to))
            self._open += [near, far]
            threading.Thread(target=self._carry, args=(near, far), daemon=True).start()

    def _carry(self, near, far):
        with near, far:
            while True:
                try:
                    for one in select.select([near, far], [], [])[0]:
                        content = one.recv(65536)
                        if not content:
                            return
                        (far if one is near else near).sendall(content)
                        self.carried += len(content)
                except (OSError, ValueError):
                    return


def test_the_first_endpoint_is_gone_for_good_and_not_a_row_differs(run_folder, tmp_path):
    up = Up(tmp_path / "up", options=["--elsewhere", "vehicle"])
    ways = []

    def two_ways(text):
        url = re.search(r'"(http://[^"]+)"', text)[1]
        ways.append(Way(int(url.rpartition(":")[2])))
        first = f"{url.rpartition(':')[0]}:{ways[0].port}"
        return text.replace(f'"{url}"', f'"{first}",\n    "{url}"', 1)

    try:
        up.start("vehicles", two_ways)
        up.wait_for_block(10)
        up.wait_for(lambda: ways[0].carried)
        ways[0].cut()
        up.end()
    finally:
        up.stop()
    one, many = decided(run_folder), decided(up.folder)
    for table in one:
        assert many[table] == one[table], table
    audited(up.folder)


@pytest.mark.parametrize("how", ["stopped", "killed"])
def test_uavs_that_were_away_are_told_and_fly_again(tmp_path, how):
    """Half the UAVs' host is away from mid-flight until the world has told of it, and is back; all of it is audited."""
    options = ["--free-running", "--slot", 1.5, "--speed", 2, "--elsewhere", "uav", "--uav-hosts", 2]
    up = Up(tmp_path / "up", "selection.rounds=2", "coordination.steps=24", options=options)
    try:
        for name in ("uavs-1", "uavs-2"):
            up.start(name)
        up.wait_for_block(16)  # of the first period's selection
        gone = up.elsewhere["uavs-2"]
        gone.send_signal(signal.SIGSTOP if how == "stopped" else signal.SIGKILL)
        up.wait_for(lambda: any("uavs-2 is silent since" in line for line in list(up.lines)))
        if how == "stopped":
            gone.send_signal(signal.SIGCONT)
        else:
            gone.wait()
            up.start("uavs-2")
        up.wait_for(lambda: any("uavs-2 is back at" in line for line in list(up.lines)))
        up.end()
    finally:
        up.stop()
    once(decided(up.folder))
    audited(up.folder)
