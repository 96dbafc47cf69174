"""The public face: what `import vlp16emu` offers, and how soon."""

import subprocess
import sys
import textwrap

import pytest

import vlp16emu


def run(code):
    """Standard output of a program of its own."""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


def test_nothing_heavy_is_loaded_with_the_package():
    """`import vlp16emu` loads no library, and its names are there all the same."""
    code = """
    import sys
    import vlp16emu
    heavy = {"numpy", "numba", "pydantic", "scipy", "dpkt", "typer", "vlp16emu.run.emulator", "vlp16emu.scenario"}
    print(sorted(heavy & set(sys.modules)), set(vlp16emu.__all__) <= set(dir(vlp16emu)))
    """
    assert run(textwrap.dedent(code)) == "[] True\n"


@pytest.mark.parametrize("name", vlp16emu.__all__)
def test_each_public_name_is_what_its_module_has(name):
    """A name is loaded when it is used, once, and has a docstring."""
    assert getattr(vlp16emu, name) is getattr(vlp16emu, name)
    assert getattr(vlp16emu, name).__doc__
