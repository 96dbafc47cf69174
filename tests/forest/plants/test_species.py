"""The species table, and tables of the user's own."""

import re
from importlib import resources

import pytest
from forest.kit import trees_of

from vlp16emu.errors import GeometryError
from vlp16emu.forest.plants.species import flora, tapers

TEXT = resources.files("vlp16emu.forest").joinpath("species.toml").read_text(encoding="utf-8")


def own_oak():
    """A user's file: English oak under another name and number."""
    tables = re.findall(r"(?ms)^\[tree\.english_oak.*?(?=^\[tree\.sycamore)", TEXT)
    return tables[0].replace("english_oak", "holm_oak").replace("number = 5", "number = 1000")


@pytest.fixture
def write(tmp_path):
    def write(text):
        path = tmp_path / "own.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_numbers_are_unique_and_never_change():
    """Species numbers stand in recorded labels, so they are fixed for ever."""
    trees = "silver_birch norway_spruce scots_pine european_beech english_oak sycamore douglas_fir"
    trees += " sugar_maple red_maple white_oak black_walnut snag"
    numbers = [
        *enumerate(trees.split(), 1),
        *enumerate(["hazel", "elder", "hawthorn", "dogwood", "honeysuckle"], 101),
    ]
    assert flora().names == dict(numbers)


def test_a_users_plants_come_after_our_own(write):
    """A file of the same form adds its trees and shrubs, and changes none of those that are there."""
    hazel = re.findall(r"(?ms)^\[shrub\.hazel.*?(?=^\[shrub\.elder)", TEXT)[0]
    path = write(own_oak() + hazel.replace("hazel", "filbert").replace("number = 101", "number = 1001"))
    table = flora(path).trees
    assert list(table) == [*flora().trees, "holm_oak"]
    assert table["holm_oak"].taper == flora().trees["english_oak"].taper
    assert list(flora(path).shrubs) == [*flora().shrubs, "filbert"]
    assert tapers(trees_of(["silver_birch"] * 2, species=[1000, 1]), table=table).shape == (2, 13)
    assert "holm_oak" not in flora().trees


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("number = 1000", "number = 999", "holm_oak.number: found 999; expected 1000 or more"),
        ("holm_oak", "scots_pine", ("scots_pine: a plant of that name is in the table already; expected "
                                   "another name")),
        ("leaf_area_index =", "leaf_area_indx =", ("holm_oak.leaf_area_indx: unknown key; expected "
                                                  "leaf_area_index, the nearest known one")),
        ("leaf_area_index = 4.5", "", "holm_oak.leaf_area_index: missing; expected a number from 0 to 20"),
        ("leaf_area_index = 4.5", "leaf_area_index = nan", ("holm_oak.leaf_area_index: found nan; "
                                                           "expected a finite number")),
        ("leaf_area_index = 4.5", 'leaf_area_index = "4"', ('holm_oak.leaf_area_index: found "4"; '
                                                           'expected a number')),
        ("bark_reflectance = 0.31 ", "bark_reflectance = 40 ", ("holm_oak.bark_reflectance: found 40; "
                                                              "expected a number from 0 to 1")),
        ('"uniform"', '"logistic"', ('holm_oak.height_curve.model: found "logistic"; expected "uniform" '
                                    'or "curtis_arney"')),
        ('"logistic"', '"exponential"', ('holm_oak.crown_base.model: found "exponential"; expected '
                                        '"logistic" or "ratio"')),
        ("[0.14657227, 3.78686023]", "[0.14657227]", ("holm_oak.height_curve.coefficients: found a list "
                                                     "of 1; expected 2 numbers for 'uniform'")),
        ('kind = "leaf"', 'kind = "frond"', ('holm_oak.foliage.kind: found "frond"; expected "leaf" or '
                                            '"shoot"')),
        ("inclination = [2.55, 1.61]", "inclination = []", ("holm_oak.foliage.inclination: found a list "
                                                           "of 0; expected mu and nu for leaves")),
        ("[tree.holm_oak]", "[bush.x]\n[tree.holm_oak]", ("[bush]: unknown table; expected [tree.NAME] or "
                                                         "[shrub.NAME]")),
        ("number = 1000", "number = ", "Invalid value"),
        ("branches_per_whorl = 1", "branches_per_whorl = 1.5", ("holm_oak.crown.branches_per_whorl: found "
                                                               "1.5; expected a whole number")),
    ],
)  # fmt: skip
def test_a_wrong_file_is_reported_by_file_species_and_key(write, old, new, message):
    """What is wrong in a user's file is named in one line: where, what was found, what was expected."""
    text = own_oak()
    assert old in text
    path = write(text.replace(old, new))
    with pytest.raises(GeometryError) as error:
        flora(path)
    assert str(error.value).startswith(f"{path}: ")
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_two_plants_with_one_number_and_a_missing_file_are_refused(write, tmp_path):
    """Numbers of a file must differ among its trees and shrubs, and a path that leads nowhere is named."""
    path = write(own_oak() + own_oak().replace("holm_oak", "cork_oak"))
    with pytest.raises(GeometryError, match=r"cork_oak\.number: found 1000, the number of holm_oak"):
        flora(path)
    with pytest.raises(GeometryError, match=r"none\.toml: no such file"):
        flora(tmp_path / "none.toml")
