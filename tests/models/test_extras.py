"""Optional packages: what they are extras of, and what is said where one is missing."""

import ast
import sys
import tomllib

import pytest

from linkplan.models.errors import LinkplanError
from linkplan.models.extras import EXTRAS, load_extra
from tests.support.data import ROOT


@pytest.mark.parametrize("module", sorted(EXTRAS))
def test_a_missing_package_is_refused_with_the_command_that_installs_it(monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    package, extra = EXTRAS[module]
    with pytest.raises(LinkplanError) as refused:
        load_extra(module, "this feature")
    expected = f"this feature needs {package}, which is not installed: pip install 'linkplan[{extra}]'"
    assert str(refused.value) == expected


def test_every_optional_package_is_in_its_extra_and_in_all_and_none_is_required():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required, extras = " ".join(project["dependencies"]).lower(), project["optional-dependencies"]
    for module, (_, extra) in EXTRAS.items():
        assert module.lower() in " ".join(extras[extra]).lower()
        assert f"{module.lower()}>" not in required
    assert extras["all"] == [f"linkplan[{','.join(sorted({extra for _, extra in EXTRAS.values()}))}]"]
    assert "linkplan[all]" in extras["dev"]  # the two commands of the README install everything


def test_no_module_loads_an_optional_package_when_it_is_imported():
    sources = [path for name in ("models", "planner", "controllers", "studies") for path in (ROOT / name).rglob("*.py")]
    assert len(sources) > 100
    for path in sources:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not {name.split(".")[0] for name in names} & set(EXTRAS), path
