"""The page in a browser whose language is no language tag."""

import json
import re
import shutil
import subprocess

import pytest

from linkplan.studies.output.document import Report
from linkplan.studies.output.report_file import report_html

# Runs a page's script about plots in a window that has only a navigator, and prints its language and what it defines.
_WINDOW = """
const vm = require("vm");
const window = { navigator: { language: %s }, console };
window.window = window.globalThis = window;
window.document = {};
window.addEventListener = () => {};
window.devicePixelRatio = 1;
window.CustomEvent = Event;
window.dispatchEvent = () => {};
window.matchMedia = () => ({ addEventListener: () => {} });
vm.runInNewContext(%s + "; result = typeof uPlot + ' ' + navigator.language", window);
console.log(window.result);
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="there is no node")
@pytest.mark.parametrize(
    ("language", "becomes"), [("en-US@posix", "en-US"), ("C", "en-US"), ("de-DE", "de-DE"), ("en", "en")]
)
def test_plots_are_drawn_whatever_a_browser_calls_its_language(language, becomes):
    page = report_html(Report(title="t", verdict="", passed=None, versions={}, sections=()))
    plots = re.findall(r"<script>\n(.*?)\n</script>", page, flags=re.DOTALL)[0]
    assert "uPlot" in plots
    program = _WINDOW % (json.dumps(language), json.dumps(plots))
    said = subprocess.run(["node", "-"], input=program, capture_output=True, text=True, check=False)
    assert said.stdout.split() == ["function", becomes], re.findall(r"^\w*Error: .*", said.stderr, flags=re.MULTILINE)
