"""Files that the user names: what is no file, has no end, or is something else."""

import os

import pytest

from vlp16emu.captures.capture import Capture
from vlp16emu.errors import InputError
from vlp16emu.extras.dataset.spec import load_spec
from vlp16emu.extras.meshes.files import load_mesh
from vlp16emu.extras.plot.sheet import read_report
from vlp16emu.extras.recorded.files import read_kitti, read_trajectory_csv, read_tum
from vlp16emu.extras.score.files import read_cloud, read_stems
from vlp16emu.extras.truth.description import read_json
from vlp16emu.extras.truth.tables import FIXES, StoredTable
from vlp16emu.extras.walk.way_points import read_way_points
from vlp16emu.forest.ground.dem import read_grid
from vlp16emu.forest.plants.species import flora
from vlp16emu.forest.stand.given_stand import read_stem_list
from vlp16emu.inputs import LARGEST_BYTES, LARGEST_TEXT_BYTES
from vlp16emu.motion.settings import Gps
from vlp16emu.scenario import load


def mesh(path):
    return load_mesh(path, unit="m", up="z")


def stems(path):
    return read_stem_list(path, flora().trees, (0.0, 0.0, 0.0))


def way(path):
    return read_way_points(path, Gps(), (0.0, 0.0))


def grid(path):
    located = (
        {"cell_m": 1.0, "corner_m": (0.0, 0.0)}
        if path.suffix == ".npy"
        else dict.fromkeys(("cell_m", "corner_m"))
    )
    return read_grid(path, **located)


def times(path):
    poses = path.with_name("poses.txt")
    poses.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n")
    return read_kitti(poses, path)


TEXTS = [
    (load, "a.toml"),
    (load, "a.json"),
    (stems, "a.csv"),
    (lambda path: flora(str(path)), "species.toml"),
    (read_tum, "a.tum"),
    (read_trajectory_csv, "a.csv"),
    (lambda path: read_kitti(path, 10.0), "a.txt"),
    (times, "times.txt"),
    (way, "a.csv"),
    (way, "a.gpx"),
]
OTHERS = [(mesh, f"a.{kind}") for kind in ("obj", "ply", "glb", "stl")]
OTHERS += [(grid, f"a.{kind}") for kind in ("asc", "npy", "tif")]
FURTHER = [
    (load_spec, "walks.toml"),
    (read_report, "score.json"),
    (read_stems, "stems.csv"),
    (lambda path: read_json(path, "a rig"), "rig.json"),
    (lambda path: StoredTable(path, FIXES.dtype), "gnss.npy"),
    (lambda path: next(iter(Capture(path))), "a.pcap"),
    (lambda path: next(iter(Capture(path))), "a.mcap"),
]
FURTHER += [(read_cloud, f"a.{kind}") for kind in ("csv", "npz", "ply", "pcd", "las", "laz")]


@pytest.mark.parametrize(("read", "name"), [*TEXTS, *OTHERS])
@pytest.mark.parametrize("found", ["is a FIFO", "is a directory", "is a device"])
def test_what_is_no_file_is_refused_before_it_is_read(tmp_path, read, name, found):
    """A FIFO that nobody writes, a folder and an endless device give one line with what they are."""
    path = tmp_path / name
    if found == "is a FIFO":
        os.mkfifo(path)
    elif found == "is a device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    with pytest.raises(InputError) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: {found}; expected ")


@pytest.mark.parametrize(("read", "name"), [*TEXTS, *OTHERS])
@pytest.mark.parametrize("odd", ["\0", "\ud800"])
def test_a_name_that_no_file_can_have_is_refused(tmp_path, read, name, odd):
    """A NUL or half a character in a name gives one line that shows it."""
    with pytest.raises(InputError) as caught:
        read(tmp_path / f"{odd}{name}")
    assert str(caught.value).startswith(f"{tmp_path}/{ascii(odd)[1:-1]}{name}: no name of a file; expected ")


@pytest.mark.parametrize(
    ("read", "name", "most_bytes"),
    [*((*text, LARGEST_TEXT_BYTES) for text in TEXTS), *((*other, LARGEST_BYTES) for other in OTHERS)],
)
def test_what_is_too_long_is_refused_before_it_is_read(tmp_path, read, name, most_bytes):
    """A file one byte longer than any that is meant is refused with both lengths."""
    path = tmp_path / name
    with path.open("wb") as file:
        file.truncate(most_bytes + 1)
    with pytest.raises(InputError) as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: found {most_bytes + 1} bytes; expected ")
    assert line.endswith(f" of at most {most_bytes} bytes")


@pytest.mark.parametrize(("read", "name"), [*(text for text in TEXTS if text[0] is not times), *OTHERS])
def test_nothing_is_shown_of_a_file_of_another_kind(tmp_path, read, name):
    """Accounts named as any input stay unread by others: the line has none of their words."""
    path = tmp_path / name
    path.write_text("root:x:0:0:secret:/root:/bin/sh\nother:x:1:1:secret:/home:/bin/sh\n" * 20)
    with pytest.raises(InputError) as caught:
        read(path)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("read", "name", "text"),
    [
        (stems, "a.csv", f"x_m,y_m,species,dbh_cm,height_m\n3,4,{'x' * 5000},20,18\n"),
        (stems, "a.csv", f"x_m,y_m,species,dbh_cm,height_m\n3,4,silver_birch,{'x' * 5000},18\n"),
        (read_tum, "a.tum", f"0 0 0 0 0 0 0 {'x' * 5000}\n"),
        (way, "a.csv", f"x_m,y_m\n0,{'x' * 5000}\n"),
        (grid, "a.asc", f"ncols 2\nnrows {'x' * 5000}\n"),
        (mesh, "a.obj", f"v 0 0 0\nf 1 1 0{'x' * 5000}\n"),
        (load, "a.toml", f"title = '{'x' * 5000}'\nschema = '{'x' * 5000}'\n"),
    ],
)
def test_what_is_found_is_shown_in_a_line(tmp_path, read, name, text):
    """Of a word of 5 000 letters no more than a line is shown."""
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read(path)
    assert 20 < str(caught.value).count("x") < 130
    assert str(caught.value).count("\n") == 0


PLACES = {
    "": "an empty file: copy or download it again",
    "version https://git-lfs.github.com/spec/v1\noid sha256:secret\nsize 7\n": (
        "a pointer of Git LFS in place of the file: `git lfs pull` fetches it"
    ),
    "\n<!DOCTYPE html>\n<html><title>secret</title></html>\n": (
        "a page of HTML in place of the file: download the file itself"
    ),
}


@pytest.mark.parametrize(("read", "name"), [*TEXTS, *OTHERS, *FURTHER])
@pytest.mark.parametrize("text", PLACES)
def test_what_came_in_the_place_of_a_file_is_named(tmp_path, read, name, text):
    """An empty file, a pointer of Git LFS (docs/spec.md of git-lfs/git-lfs, the one there but for its sum)
    and a page of HTML are called so for every kind of input, and none of their text is shown."""
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: {PLACES[text]}; expected ")
    assert "secret" not in line
