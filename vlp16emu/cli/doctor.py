"""`vlp16emu doctor`: whether this machine is fit for each verb."""

from dataclasses import asdict

import typer

from vlp16emu.cli.arguments import AsJson
from vlp16emu.cli.terminal import print_json, print_rows


def doctor(*, as_json: AsJson = False) -> None:
    """Check this machine: cores, kernels, Embree, ports, rights, clock, wake-ups, buffers, extras, disk.

    Each row is ok, a warning where some runs will suffer, or a problem where some will fail, with what mends it. The
    exit code is 1 where there is a problem. Wake-ups are measured now, beside all that this machine is doing.
    """
    from vlp16emu.extras.doctor import all_checks
    from vlp16emu.sinks import Condition

    checks = list(all_checks())
    counts = {finding.value: sum(check.finding is finding for check in checks) for finding in Condition}
    if as_json:
        print_json({"checks": [asdict(check) for check in checks], **counts})
    else:
        rows = dict[str, str]()
        for check in checks:
            rows[check.name] = f"{check.finding:<7}  {check.found}"
            if check.mend:
                rows[check.name] += f"; {check.mend}"
        print_rows("this machine", rows)
    if counts[Condition.PROBLEM]:
        raise typer.Exit(1)
