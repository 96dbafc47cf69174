"""`vlp16emu doctor`: whether this machine is fit for each verb."""

import typer

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.printer import print_json, print_rows


def doctor(*, as_json: AsJson = False) -> None:
    """Check this machine: cores, kernels, Embree, ports, rights, clock, wake-ups, buffers, extras, disk.

    Each row is ok, a warning if some runs will suffer, or a problem if some will fail, with what mends it. The
    exit code is 1 if there is a problem. Wake-ups are measured now, beside all that this machine is doing.
    """
    from vlp16emu.extras.doctor import all_checks
    from vlp16emu.extras.readiness import Condition

    checks = list(all_checks())
    counts = {finding.value: sum(check.finding is finding for check in checks) for finding in Condition}
    if as_json:
        print_json({"checks": checks, **counts})
    else:
        mends = [f"; {check.mend}" if check.mend else "" for check in checks]
        pairs = zip(checks, mends, strict=True)
        print_rows("this machine", {one.name: f"{one.finding:<7}  {one.found}{mend}" for one, mend in pairs})
    if counts[Condition.PROBLEM]:
        raise typer.Exit(1)
