"""What each module offers to others."""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "vlp16emu"


@cache
def trees() -> dict[str, ast.Module]:
    """Modules by name, read by the worker that has these tests and by no other."""
    return {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): ast.parse(
            path.read_text(encoding="utf-8")
        )
        for path in sorted(PACKAGE.rglob("*.py"))
        if path.name != "__main__.py"
    }


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


def test_all_is_complete_sorted_and_true():
    """`__all__` names every public function and class of a module, each once, in order, and nothing that is absent."""
    for module, tree in trees().items():
        names = listed(tree) or []
        assert names == in_order(list(dict.fromkeys(names))), module
        assert defined(tree) <= set(names), module
        loaded = import_module(module)
        assert [name for name in names if not hasattr(loaded, name)] == [], module


def test_what_one_module_takes_the_other_offers():
    """A name imported from one of our modules stands in that module's `__all__`."""
    modules = {module.rpartition(".")[2] for module in trees()}
    for module, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in trees():
                offered = {*(listed(trees()[node.module]) or []), *modules}
                assert {alias.name for alias in node.names} <= offered, f"{module}, line {node.lineno}"


def test_a_room_offers_what_it_has_by_name():
    """A room's own `__init__` says in a docstring what it is for, and re-exports names."""
    rooms = [f"vlp16emu.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")]
    assert len(rooms) > 10
    for room in rooms:
        assert ast.get_docstring(trees()[room]), room
        assert listed(trees()[room]), room
