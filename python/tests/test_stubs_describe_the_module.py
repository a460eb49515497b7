"""Every public class, function, method and property has a description, and the stub has the same one."""

import ast
import inspect
from pathlib import Path

import pytest
import upswing
from upswing import _upswing

STUB = ast.parse(Path(upswing.__file__).with_name("_upswing.pyi").read_text(encoding="utf-8"))
# Their descriptions are those of the functions of Python around them.
WRAPPED = {"read_recording", "report_html", "_repr_html_page"}


def descriptions():
    for node in STUB.body:
        if isinstance(node, ast.FunctionDef):
            yield node.name, ast.get_docstring(node)
        if isinstance(node, ast.ClassDef):
            methods = [m for m in node.body if isinstance(m, ast.FunctionDef)]
            created = [ast.get_docstring(m) for m in methods if m.name == "__new__"]
            yield node.name, "\n\n".join(filter(None, [ast.get_docstring(node), *created]))
            for method in methods:
                setter = any(isinstance(d, ast.Attribute) for d in method.decorator_list)
                if not method.name.startswith("__") and not setter:
                    yield f"{node.name}.{method.name}", ast.get_docstring(method)


@pytest.mark.parametrize("name, expected", [(n, d) for n, d in descriptions() if n.split(".")[-1] not in WRAPPED])
def test_description(name, expected):
    item = _upswing
    for part in name.split("."):
        item = getattr(item, part)
    assert expected and inspect.getdoc(item) == inspect.cleandoc(expected)


def test_nothing_is_missing_in_the_stub():
    named = {name for name, _ in descriptions()}
    for name, item in vars(_upswing).items():
        if name.startswith("__"):
            continue
        assert name in named, name
        if inspect.isclass(item):
            public = {f"{name}.{part}" for part in vars(item) if not part.startswith("_")}
            assert public <= named, public - named
