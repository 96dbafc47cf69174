"""The public face: what `import vlp16emu` offers."""

import pytest

import vlp16emu


@pytest.mark.parametrize("name", vlp16emu.__all__)
def test_each_public_name_is_what_its_module_has(name):
    """A name is listed, is loaded when it is used, once, and has a docstring."""
    assert name in dir(vlp16emu)
    assert getattr(vlp16emu, name) is getattr(vlp16emu, name)
    assert getattr(vlp16emu, name).__doc__
