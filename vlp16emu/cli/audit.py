"""The audit beside a run, as option, as JSON and as a line for people."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from vlp16emu.emulator import Emulator
    from vlp16emu.fidelity import Audit
    from vlp16emu.scenario import Scenario

__all__ = ["NoAudit", "audit_row", "audit_tree", "audited"]

NoAudit = Annotated[
    bool,
    typer.Option(
        "--no-audit", help="Do not cast 0.05 % of the pulses again to estimate the error of the run."
    ),
]


def audited(scenario: "Scenario", *, threads: int, no_audit: bool) -> "tuple[Emulator, Audit | None]":
    """Make the emulator of a run, and its audit unless that is not wanted."""
    from vlp16emu.emulator import Emulator

    if no_audit:
        return Emulator(scenario, threads=threads), None
    from vlp16emu.fidelity import Audit

    audit = Audit.of(scenario)
    return Emulator(scenario, threads=threads, audit=audit), audit


def audit_tree(audit: "Audit | None") -> dict[str, Any] | None:
    """Put what an audit found into the types of JSON: shares of returns, None for what is not known."""
    if audit is None:
        return None
    tally = audit.tally
    interval_m = tally.range_rmse_interval_m

    def share(of: int) -> float | None:
        """Share of the returns that were looked at."""
        return of / tally.returns if tally.returns else None

    return {
        "exact": audit.exact,
        "pulses": tally.pulses,
        "range_rmse_m": tally.range_rmse_m,
        "range_rmse_low_m": interval_m and interval_m.low,
        "range_rmse_high_m": interval_m and interval_m.high,
        "lost": share(tally.lost),
        "invented": share(tally.invented),
        "other_echo": share(tally.wrong_strongest),
    }


def audit_row(tree: dict[str, Any] | None) -> dict[str, str]:
    """Write that as a row of the summary; no row where nobody looked."""
    if tree is None:
        return {}
    if tree["exact"]:
        return {"range error": "rounding to float32 only: by the scene's choice a pulse is one ray"}
    if tree["range_rmse_m"] is None:
        return {"range error": f"not known: {tree['pulses']} pulses cast again had no return"}
    sure = "interval not known from so few"
    if tree["range_rmse_low_m"] is not None:
        sure = f"95 %: {1e3 * tree['range_rmse_low_m']:.1f} to {1e3 * tree['range_rmse_high_m']:.1f} mm"
    shares = "lost", "invented", "other_echo"
    lost, invented, other = (f"{100 * tree[share]:.1f} %" for share in shares)
    return {
        "range error": f"RMSE {1e3 * tree['range_rmse_m']:.1f} mm before noise ({sure}), "
        f"{lost} lost, {invented} invented, {other} of another echo"
    }
