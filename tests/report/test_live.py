"""The control room's server over real sockets: what it tells, to whom, and what it does with those who are no pages."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
import requests
import typer
from typer.testing import CliRunner
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from skyrelay.cli.live import command
from skyrelay.core.errors import UsageError
from skyrelay.report.live import PROTOCOL, WAITING, ControlRoom
from skyrelay.report.replay import header, records, replay
from skyrelay.runfolder import Run, read_run
from skyrelay.runfolder.feed import Feed, Header, Record, read_header, read_record

TOKEN = "a-token-of-this-test"  # noqa: S105


@pytest.fixture(scope="module")
def run(recorded: Path) -> Run:
    return read_run(recorded)


def within(told: Awaitable[Any]) -> Awaitable[Any]:
    """Ends a test that would wait for ever."""
    return asyncio.wait_for(told, 30)


def served(room: ControlRoom, feed: Feed, act: Callable[[int], Awaitable[None]]) -> None:
    """Serve a feed on a free port while ``act`` does something there."""

    async def all_of_it() -> None:
        async with room.open("127.0.0.1", 0) as server:
            following = asyncio.create_task(room.follow(feed))
            await within(act(server.sockets[0].getsockname()[1]))
            following.cancel()

    asyncio.run(all_of_it())


def page(port: int, *, query: str = "", protocols: Any = (PROTOCOL,), **options: Any) -> connect:
    return connect(f"ws://127.0.0.1:{port}/feed{query}", subprotocols=protocols, max_size=None, **options)


async def heard(client: ClientConnection, count: int) -> list[Record]:
    return [read_record(await client.recv()) for _ in range(count)]


def test_a_recorded_run_is_told_row_for_row(run: Run, recorded: Path) -> None:
    async def act(port: int) -> None:
        async with page(port) as client:
            first = read_header(await client.recv())
            assert (first.name, first.range_m, first.grid) == (run.summary.name, run.summary.range_m, run.summary.grid)
            told = await heard(client, run.summary.steps + 1)
        assert [record.step for record in told] == list(range(run.summary.steps + 1))
        vehicles = [(record.step, *row) for record in told for row in record.vehicles]
        wanted = ("step", "vehicle", "x", "y", "uav", "covered")
        assert vehicles == [tuple(row[name] for name in wanted) for row in rows(recorded, "vehicles")]
        uavs = [(record.step, *row[:6]) for record in told for row in record.uavs]
        of_uavs = ("step", "uav", "x", "y", "zone", "battery", "selected")
        assert uavs == [tuple(row[name] for name in of_uavs) for row in rows(recorded, "uavs")]
        assert sum(len(record.events) for record in told) == len(run.events["block"])
        assert [alert.about for alert in told[15].alerts if "landed" in alert.text] == ["uav_00"]

    served(ControlRoom(), replay(run, float("inf")), act)


def rows(folder: Path, table: str) -> list[dict[str, Any]]:
    return pq.read_table(folder / f"{table}.parquet").to_pylist()


def test_a_step_is_told_when_it_is_due(run: Run) -> None:
    async def due() -> list[float]:
        loop, told = asyncio.get_running_loop(), []
        begin = loop.time()
        async for message in replay(run, 100.0):  # 2 s are 20 ms
            told.append(loop.time() - begin)
            if isinstance(message, Record) and message.step == 5:
                break
        return told

    told = asyncio.run(due())
    assert all(at >= 0.02 * step - 1e-3 for step, at in enumerate(told[1:]))


def test_who_comes_late_or_again_hears_what_it_missed(run: Run) -> None:
    more = asyncio.Event()

    async def feed() -> Feed:
        yield header(run)
        for record in records(run):
            if record.step == 11:
                await more.wait()
            yield record

    async def act(port: int) -> None:
        async with page(port) as client:
            session = read_header(await client.recv()).session
            assert [record.step for record in await heard(client, 11)] == list(range(11))
        for query, first in (
            (f"?session={session}&after=7", 8),
            ("?session=other&after=7", 0),
            ("?after=x", 0),
            ("?" + "a&" * 99, 0),
            ("?" + "a&" * 99, 0),
        ):
            async with page(port, query=query) as client:
                read_header(await client.recv())
                assert (await heard(client, 1))[0].step == first
        async with page(port, query=f"?session={session}&after=10") as client:
            read_header(await client.recv())
            more.set()
            assert (await heard(client, 1))[0].step == 11

    served(ControlRoom(), feed(), act)


def test_it_is_read_only(run: Run) -> None:
    async def act(port: int) -> None:
        async with page(port) as client:
            await client.send("{}")
            with contextlib.suppress(ConnectionClosed):
                async for _ in client:
                    pass
            assert client.close_code == 1008
        async with page(port) as client:
            await client.send("x" * 100_000)
            await client.wait_closed()
            assert client.close_code == 1009

    served(ControlRoom(), one(header(run)), act)


async def one(*messages: Header | Record) -> AsyncIterator[Header | Record]:
    for message in messages:
        yield message


def test_pages_of_other_sites_and_other_names_are_refused(run: Run) -> None:
    async def act(port: int) -> None:
        for options in (
            {"origin": "https://example.org"},
            {"origin": f"http://127.0.0.1:{port + 1}"},
            {"additional_headers": {"Host": "example.org"}},  # a second one
        ):
            with pytest.raises(InvalidStatus, match=r"40[03]"):
                async with page(port, **options):
                    pass
        async with page(port, origin=f"http://127.0.0.1:{port}") as client:
            assert read_header(await client.recv())
        answer = await asyncio.to_thread(requests.get, f"http://127.0.0.1:{port}/", timeout=20)
        assert 'data-source="live"' in answer.text
        assert "connect-src 'self'" in answer.text
        for path, headers, status in (("/x", {}, 404), ("/", {"Host": "example.org"}, 403), ("/", {"Host": "["}, 403)):
            url = f"http://127.0.0.1:{port}{path}"
            assert (await asyncio.to_thread(requests.get, url, headers=headers, timeout=20)).status_code == status

    served(ControlRoom(), one(header(run)), act)


def test_a_token_is_wanted_where_there_is_one(run: Run) -> None:
    async def act(port: int) -> None:
        for protocols in ((PROTOCOL,), (PROTOCOL, "token." + TOKEN[:-1]), (PROTOCOL, TOKEN)):
            async with page(port, protocols=protocols) as client:
                with pytest.raises(ConnectionClosed):
                    await client.recv()
                assert client.close_code == 4001
        async with page(port, protocols=(PROTOCOL, "token." + TOKEN)) as client:
            assert client.subprotocol == PROTOCOL  # the token is not said back
            assert read_header(await client.recv())

    served(ControlRoom(TOKEN), one(header(run)), act)


def test_a_page_that_does_not_keep_up_is_let_go_and_others_are_not(run: Run) -> None:
    begin = asyncio.Event()
    large = [next(iter(records(run))).model_copy(update={"step": step}) for step in range(8 * WAITING)]

    async def feed() -> Feed:
        yield header(run)
        await begin.wait()
        for record in large:
            yield record
            await asyncio.sleep(0)

    async def act(port: int) -> None:
        async with page(port, max_queue=1) as slow, page(port) as client:
            read_header(await client.recv())
            read_header(await slow.recv())
            begin.set()
            steps = [record.step for record in await heard(client, len(large))]
            assert steps == list(range(len(large)))
            with contextlib.suppress(ConnectionClosed):  # it reads only now
                async for _ in slow:
                    pass
            assert slow.close_code == 1013

    served(ControlRoom(), feed(), act)


def test_beyond_loopback_there_has_to_be_a_token() -> None:
    async def opens(room: ControlRoom, host: str) -> None:
        async with room.open(host, 0):
            pass

    for host in ("0.0.0.0", "::", "example.org"):  # noqa: S104
        with pytest.raises(UsageError, match="token-file"):
            asyncio.run(opens(ControlRoom(), host))
    asyncio.run(opens(ControlRoom(TOKEN), "0.0.0.0"))  # noqa: S104
    for token in ("short", "with space in its middle", "x" * 129, ""):
        with pytest.raises(UsageError) as caught:
            ControlRoom(token)
        assert not token or token not in str(caught.value)


def test_bad_input_is_one_line(tmp_path: Path, recorded: Path) -> None:
    app = typer.Typer()
    app.command()(command)
    for arguments, said in (
        ([str(tmp_path)], "scenario.toml"),
        ([str(recorded), "--host", "0.0.0.0"], "token-file"),  # noqa: S104
        ([str(recorded), "--token-file", str(tmp_path / "none")], "--token-file"),
    ):
        result = CliRunner().invoke(app, arguments)
        assert said in str(result.exception)
        assert "\n" not in str(result.exception)


def test_an_address_that_is_taken_is_one_line(run: Run) -> None:
    async def act(port: int) -> None:
        with pytest.raises(UsageError, match="an address that is free"):
            async with ControlRoom().open("127.0.0.1", port):
                pass

    served(ControlRoom(), one(header(run)), act)


def test_records_are_what_the_feed_says(run: Run) -> None:
    for record in records(run):
        assert read_record(json.dumps(json.loads(record.model_dump_json()))) == record
