"""The lint as a command."""

import pytest


@pytest.mark.parametrize("mode", ["strongest", "dual"])
def test_our_own_recordings_are_clean(cli, each_unit, tmp_path, mode):
    """What `record` writes breaks no rule: exit 0, nothing but the summary."""
    path = tmp_path / "x.pcap"
    settings = "--set", f"sensor.return_mode={mode}", "--set", "start_utc=2026-05-20T08:59:59.9Z"
    cli("record", each_unit, path, "--duration", "0.5", *settings)
    outcome = cli("verify", path, "--json")
    assert outcome.code == 0
    assert (outcome.tree["clean"], outcome.tree["findings"]) == (True, [])
    assert cli("verify", path).out.startswith(f"{path}: clean\n")


@pytest.mark.parametrize("ports", [(2370, 8308), (2368, 9000), (8308, 2368), (40_000, 40_001)])
def test_packets_may_go_to_any_port(cli, tmp_path, ports):
    """A sensor whose user has chosen other ports, even each other's, sends nothing wrong."""
    path = tmp_path / "ports.pcap"
    setting = f"sensor.data_port={ports[0]}", f"sensor.position_port={ports[1]}"
    cli("record", "static_bench", path, "--duration", "0.05", "--set", setting[0], "--set", setting[1])
    outcome = cli("verify", path, "--json")
    assert outcome.code == 0, outcome.tree["findings"]
    assert outcome.tree["packets"] > 30
    assert outcome.tree["position_packets"] > 5


def test_a_broken_rule_is_named_with_its_packet(cli, bench, tmp_path):
    """A damaged block flag exits with 1 and names rule and packet, for people and as JSON."""
    content = bytearray(bench.read_bytes())
    place = content.index(b"\xff\xee")
    content[place] = 0
    damaged = tmp_path / "damaged.pcap"
    damaged.write_bytes(content)
    outcome = cli("verify", damaged, "--json")
    assert outcome.code == 1
    assert outcome.tree["clean"] is False
    (finding,) = outcome.tree["findings"]
    assert finding["rule"] == "flag"
    assert outcome.tree["broken_rules"] == {"flag": 1}
    text = cli("verify", damaged).out
    assert text.startswith(f"packet {finding['packet']}: flag: {finding['found']}; expected ")
    assert f"{damaged}: not what a VLP-16 sends\n" in text
