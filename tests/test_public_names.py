"""What each module offers to others."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if path.name != "__main__.py"
)
ROOMS = sorted(f"vlp16emu.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py"))


def source(module: str) -> ast.Module:
    stem = PACKAGE.parent.joinpath(*module.split("."))
    path = stem / "__init__.py" if stem.is_dir() else stem.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def defined(tree: ast.Module) -> set[str]:
    """Public functions and classes that stand at the top level."""
    kinds = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef
    return {node.name for node in tree.body if isinstance(node, kinds) and not node.name.startswith("_")}


def listed(tree: ast.Module) -> list[str] | None:
    """Read the value of `__all__`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == ["__all__"]:
            return ast.literal_eval(node.value)
    return None


def in_order(names: list[str]) -> list[str]:
    """Constants, then classes, then functions, each from a to z: the order that ruff keeps."""
    return sorted(names, key=lambda name: (0 if name.isupper() else 1 if name[0].isupper() else 2, name))


@pytest.mark.parametrize("module", MODULES)
def test_all_is_complete_sorted_and_true(module):
    """`__all__` names every public function and class of a module, each once, in order, and nothing that is absent."""
    tree = source(module)
    names = listed(tree)
    if names is None:
        assert not defined(tree)
        return
    assert names == in_order(list(dict.fromkeys(names)))
    assert defined(tree) <= set(names)
    loaded = import_module(module)
    assert [name for name in names if not hasattr(loaded, name)] == []


@pytest.mark.parametrize("module", MODULES)
def test_what_one_module_takes_the_other_offers(module):
    """A name imported from one of our modules stands in that module's `__all__`."""
    for node in ast.walk(source(module)):
        if isinstance(node, ast.ImportFrom) and node.module in MODULES:
            offered = {*(listed(source(node.module)) or []), *(m.rpartition(".")[2] for m in MODULES)}
            assert {alias.name for alias in node.names} <= offered, f"line {node.lineno}"


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_offers_what_it_has_by_name(room):
    """A room's own `__init__` says in a docstring what it is for, and re-exports names."""
    tree = source(room)
    assert ast.get_docstring(tree)
    assert listed(tree)
