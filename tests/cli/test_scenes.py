"""Scenes and their schema on stdout."""

from vlp16emu.scenario import scene_files, schema


def test_scenes_are_listed_with_title_and_duration(cli):
    """Each scene that can be called by name has a line with its title."""
    lines = cli("scenes").out.splitlines()
    assert lines[0] == "scenes"
    assert [line.split()[0] for line in lines[1:]] == list(scene_files())
    assert lines[1].endswith("60 s  A walk through a stand of silver birch")


def test_scenes_as_json_lead_to_their_files(cli):
    """The JSON list has name, kinds and the path of the file."""
    rows = cli("scenes", "--json").tree["scenes"]
    assert {row["name"]: row["file"] for row in rows} == {n: str(p) for n, p in scene_files().items()}
    assert rows[0]["motion"] == "walk"
    assert rows[0]["world"] == "forest"


def test_the_schema_is_printed_whole(cli):
    """`schema` prints one JSON object, the schema of the scene file."""
    assert cli("schema").tree == schema()
