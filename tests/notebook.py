"""Writes the notebook of docs/ with what its cells print and draw: ``python -m tests.notebook``."""

import ast
import base64
import contextlib
import io
import json
import os
import tempfile
from pathlib import Path

import matplotlib as mpl

from tests.paths import ROOT

NOTEBOOK = ROOT / "docs" / "python.ipynb"
DPI = 70


def lines(text):
    return text.splitlines(keepends=True)


def shown(value):
    """Return what Jupyter stores of the last expression of a cell."""
    data = {"text/plain": lines(repr(value))}
    if (html := getattr(value, "_repr_html_", None)) is not None:
        data["text/html"] = lines(html())
    return data


def figures():
    """Yield the open figures as outputs, and close them."""
    import matplotlib.pyplot as plt

    for number in plt.get_fignums():
        drawn = io.BytesIO()
        figure = plt.figure(number)
        figure.savefig(drawn, dpi=DPI, bbox_inches="tight", metadata={"Software": None})
        data = {"image/png": base64.b64encode(drawn.getvalue()).decode() + "\n"}
        yield {"output_type": "display_data", "metadata": {}, "data": data}
    plt.close("all")


def run(source, names):
    """Run a cell as Jupyter does; return its outputs but for the number of a result."""
    tree, printed, found = ast.parse(source), io.StringIO(), None
    last = tree.body[-1]
    is_shown = isinstance(last, ast.Expr) and not source.rstrip().endswith(";")
    if is_shown:
        tree.body.pop()
    with contextlib.redirect_stdout(printed):
        exec(compile(tree, "cell", "exec"), names)
        if is_shown:
            found = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    if text := printed.getvalue():
        yield {"output_type": "stream", "name": "stdout", "text": lines(text)}
    if found is not None:
        yield {"output_type": "execute_result", "metadata": {}, "data": shown(found)}
    yield from figures()


def run_all(notebook):
    """Run all cells, and write their outputs into the notebook."""
    import matplotlib.pyplot as plt

    plt.close("all")
    names, count = {}, 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            cell["outputs"] = list(run("".join(cell["source"]), names))
            cell["execution_count"] = count
            for output in cell["outputs"]:
                if output["output_type"] == "execute_result":
                    output["execution_count"] = count
    return names


if __name__ == "__main__":
    mpl.use("agg")
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        back = Path.cwd()
        os.chdir(folder)
        run_all(notebook)
        os.chdir(back)
    text = json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    NOTEBOOK.write_text(text, encoding="utf-8")
