"""What a run folder keeps of addresses."""

from __future__ import annotations

from skyrelay.core.scenario import load_scenario, to_toml
from skyrelay.simulation.run import without_credentials


def test_a_folder_keeps_neither_names_nor_passwords_nor_tokens() -> None:
    urls = "https://me:hunter2@node.example/v3/t0ken?key=s3cret,http://127.0.0.1:8545"
    scenario = load_scenario(overrides=[f'chain.url="{urls}"', 'store.url="https://me:hunter2@store.example"'])
    text = to_toml(without_credentials(scenario))
    assert not any(secret in text for secret in ("hunter2", "t0ken", "s3cret", "me:"))
    assert "https://node.example/..., http://127.0.0.1:8545" in text
    plain = load_scenario(overrides=["chain.url=http://127.0.0.1:8545"])
    assert without_credentials(plain) == plain
    assert without_credentials(load_scenario()) == load_scenario()
