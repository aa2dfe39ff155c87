"""Every claim that the paper makes in numbers or by its curves, and the page that sets it beside what was measured."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

from skyrelay.core.errors import RunFolderError
from skyrelay.core.files import write_text
from skyrelay.core.untrusted import read_json

Verdict = Literal["holds", "holds in part", "does not hold"]
FINDINGS = "claims.json"


@dataclass(frozen=True)
class Claim:
    """What the paper says.

    Attributes:
        key: by which a finding refers to it.
        says: in our words.
        source: section, figure or table.
    """

    key: str
    says: str
    source: str


@dataclass(frozen=True)
class Finding:
    """What was measured about one claim in one setting.

    Attributes:
        claim: key of the claim.
        setting: under which assumptions, with seeds.
        measured: the value, with its 95 % interval where there is one.
        verdict: whether the claim holds there.
    """

    claim: str
    setting: str
    measured: str
    verdict: Verdict


_SELECTION = 'Section "Selection Mechanism"'
_COORDINATION = 'Section "MDRL-based Coordination"'
_COST = 'Table "Implementation Cost"'

CLAIMS: tuple[Claim, ...] = (
    Claim("selection.qou", "QoU of selected UAVs at least 13 % above NNM", f"{_SELECTION}, Fig. average QoU"),
    Claim("selection.qov", "QoV of selected vehicles at least 10 % above NNM", f"{_SELECTION}, Fig. average QoV"),
    Claim("selection.qov-average", "QoV 10 % above NNM on average over the numbers of UAVs", _SELECTION),
    Claim("selection.qou-rises", "QoU rises with the number of UAVs", f"{_SELECTION}, Fig. average QoU"),
    Claim("selection.nnm-stable", "NNM's QoU does not depend on the number of UAVs", _SELECTION),
    Claim("selection.few-uavs", "Up to 20 UAVs both have a similar number of vehicles per UAV", _SELECTION),
    Claim("selection.vehicles-per-uav", "Above 20 UAVs more vehicles per selected UAV than NNM", _SELECTION),
    Claim("selection.fewer-uavs", "Above 20 UAVs a much smaller percentage of UAVs selected than NNM", _SELECTION),
    Claim("selection.stable", "The selection is a stable matching, optimal for the vehicles", f"{_SELECTION} (GSM)"),
    Claim("coordination.converges", "Learning converges to -4...-5 for 2 to 5 UAVs, 5 to 20 vehicles", _COORDINATION),
    Claim("coordination.slower", "Convergence is slightly slower with more vehicles", _COORDINATION),
    Claim("coordination.steps", "5 UAVs need 4 steps on average to full connectivity and coverage", _COORDINATION),
    Claim("coordination.centralized", "Centralised learning falls behind, the more the larger the team", _COORDINATION),
    Claim("coordination.parameters", "1.692M parameters at any team size; centralised 9.31M at 5 UAVs", _COORDINATION),
    Claim("coordination.flops", "About 1 MFLOP a decision; centralised up to 41 MFLOP at 5 UAVs", _COORDINATION),
    Claim("coordination.coverage", "Coverage above centralised learning at every number of vehicles", _COORDINATION),
    Claim("coordination.connectivity", "Connectivity above centralised learning", _COORDINATION),
    Claim("coordination.connected", "Connectivity 0.95 on average (each UAV has a neighbour)", _COORDINATION),
    Claim("coordination.placement", "Coverage of PSO placement deteriorates with more vehicles", _COORDINATION),
    Claim("coordination.placement-connected", "PSO placement keeps full connectivity", _COORDINATION),
    Claim("gas.deployment", "Deployment for 2,932,986 gas", _COST),
    Claim("gas.registerUAV", "registerUAV for 265,964 gas", _COST),
    Claim("gas.registerVehicle", "registerVehicle for 161,646 gas", _COST),
    Claim("gas.updateVehicleInfo", "updateVehicleInfo for 54,002 gas", _COST),
    Claim("gas.updateUAVInfo", "updateUAVInfo for 67,287 gas", _COST),
    Claim("gas.updateUAVZone", "updateUAVZone for 104,492 gas", _COST),
    Claim("gas.submitVehSelection", "submitVehSelection for 159,442 gas", _COST),
    Claim("gas.resetListsForZone", "resetListsForZone for 116,565 gas", _COST),
)
_KEYS = frozenset(claim.key for claim in CLAIMS)


def write_findings(folder: Path, findings: Sequence[Finding]) -> Path:
    """Keep what a figure found beside its results.

    Raises:
        KeyError: a finding is about no claim of the paper.
    """
    for finding in findings:
        if finding.claim not in _KEYS:
            raise KeyError(finding.claim)
    path = folder / FINDINGS
    write_text(path, json.dumps([asdict(finding) for finding in findings], indent=1) + "\n")
    return path


def write_claims_page(out: Path) -> Path:
    """Write ``claims.md``: every claim of the paper, beside the findings of all figures in the folders of ``out``.

    Raises:
        RunFolderError: a file of findings cannot be read.
    """
    found: dict[str, list[tuple[str, Finding]]] = {claim.key: [] for claim in CLAIMS}
    for path in sorted(out.glob(f"*/{FINDINGS}")):
        try:
            findings = [Finding(**entry) for entry in read_json(path)]
            for finding in findings:
                found[finding.claim].append((path.parent.name, finding))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise RunFolderError(path, None, f"findings as `skyrelay reproduce` writes them ({error})") from error
    lines = [
        "# The paper's claims, measured",
        "",
        "Written by `skyrelay reproduce`. Intervals are 95 % intervals over seeds. A claim without a measurement is",
        "one whose figure is not in this folder.",
        "",
        "| claim | source | setting | measured | verdict |",
        "| --- | --- | --- | --- | --- |",
    ]
    for claim in CLAIMS:
        rows = found[claim.key]
        if not rows:
            lines.append(_row(claim.says, claim.source, "", "not measured here", ""))
        for folder, finding in rows:
            setting = f"{finding.setting} ([{folder}]({folder}/))"
            lines.append(_row(claim.says, claim.source, setting, finding.measured, f"**{finding.verdict}**"))
    path = out / "claims.md"
    write_text(path, "\n".join(lines) + "\n")
    return path


def _row(*cells: str) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
