"""How bright the user's things are."""

import math

import pytest

from vlp16emu.errors import ScenarioError
from vlp16emu.extras.meshes.settings import MeshPart
from vlp16emu.scenario import load
from vlp16emu.world.settings import HallBox


def box(finish):
    table = f"{{ name = 'sign', centre_m = [8.0, 0.0, 1.5], size_m = [0.1, 1.0, 1.0]{finish and f', {finish}'} }}"
    return load("static_bench", [f"world.boxes=[{table}]"]).world.boxes[0]


@pytest.mark.parametrize(
    ("finish", "brightness"),
    [("", 0.5), ("reflectance = 0.3", 0.3), ("retroreflection_cd_lx_m2 = 250.0", 250 * math.pi)],
)
def test_brightness_is_that_of_a_white_wall(finish, brightness):
    """A diffuse thing has its reflectance, a reflector pi times its coefficient, for a white Lambertian wall has 1 / pi."""
    assert box(finish).brightness == brightness


@pytest.mark.parametrize(
    ("finish", "words"),
    [
        ("reflectance = 0.3, retroreflection_cd_lx_m2 = 70.0", r"boxes\[0\]: .* not both"),
        ("reflectance = 30.0", r"boxes\[0\].reflectance: found 30.0; expected a number from 0 to 1$"),
        ("retroreflection_cd_lx_m2 = 0.5", r"_m2: found 0.5; expected a number from 1 to 1000$"),
    ],
)
def test_a_finish_that_cannot_be_is_refused(finish, words):
    """Percent are no reflectance, what does not outshine a white wall is no reflector, and one finish is enough."""
    with pytest.raises(ScenarioError, match=words):
        box(finish)


def test_a_part_that_tells_nothing_takes_the_finish_of_the_whole():
    """Parts of a mesh have no brightness of their own unless the file has one."""
    assert MeshPart(name="stem").brightness is None
    assert MeshPart(name="tag", retroreflection_cd_lx_m2=100.0).brightness == 100 * math.pi


@pytest.mark.parametrize("finish", ["reflectance = 0.3", "retroreflection_cd_lx_m2 = 250.0"])
def test_a_finish_can_be_written_and_read_again(finish):
    """What a scenario writes about a thing is read as the same thing."""
    own = box(finish)
    assert HallBox.model_validate(own.model_dump()).brightness == own.brightness
