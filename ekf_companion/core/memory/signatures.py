"""Signatures of the compiled kernel, made from the annotations of its functions.

A module of the kernel whose functions take structs and numbers needs no ``.pxd`` by hand: each
annotation has one meaning in C, and what the file cimports, its signatures may name. Kept by hand
are those of classes, of inline casts and of functions that Python calls with tuples.
"""

import ast
from pathlib import Path

CORE = Path(__file__).parent.parent
MARK = "# Made from {} by setup.py"
CIMPORTS = "cython.cimports."
PASSED = {
    "float": "double {}",
    "int": "Py_ssize_t {}",
    "bool": "bint {}",
    "Dcm": "double {}[3][3]",
    "Square": "double {}[N][N]",
    "Numbers": "double[::1] {}",
    "Vector": "Vector {}",
    "Structs": "Structs {}",
}
"""A parameter in C; any other annotation is a struct, which is passed by its address."""
RETURNED = {"None": "void", "float": "double", "int": "Py_ssize_t", "bool": "bint"}


def kernel_modules() -> list[str]:
    """Return the compiled modules of the kernel: those that name others as the compiler does."""
    found = {path: path.read_text(encoding="utf-8") for path in CORE.rglob("*.py")}
    names = [path for path, text in found.items() if f"\nfrom {CIMPORTS}" in text]
    return sorted(".".join(path.relative_to(CORE).with_suffix("").parts) for path in names)


def signatures(name: str, source: str) -> str:
    """Return the ``.pxd`` of a module: what its signatures name, and its functions.

    Args:
        name: Of the module, in ``core``.
        source: Its text; every function of the module is one of the kernel.
    """
    functions = [one for one in ast.parse(source).body if isinstance(one, ast.FunctionDef)]
    lines = [_signature(one) for one in functions]
    named = {_hint(arg.annotation) for one in functions for arg in one.args.args}
    named |= {"N"} if "Square" in named else set()
    head = [MARK.format(name)]
    for node in ast.parse(source).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(CIMPORTS):
            found = sorted(alias.name for alias in node.names if alias.name in named)
            if found:
                module = str(node.module).removeprefix(CIMPORTS)
                head.append(f"from {module} cimport {', '.join(found)}")
    return "\n".join([*head, *lines]) + "\n"


def _signature(function: ast.FunctionDef) -> str:
    """Return a function's declaration in C."""
    passed = ", ".join(
        PASSED.get(hint := _hint(arg.annotation), hint + " *{}").format(arg.arg)
        for arg in function.args.args
    )
    returned = RETURNED[_hint(function.returns)]
    return f"cdef {returned} {function.name}({passed}) noexcept nogil"


def _hint(annotation: ast.expr | None) -> str:
    """Return an annotation as it is written."""
    return "None" if annotation is None else ast.unparse(annotation)
