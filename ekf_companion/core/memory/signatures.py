"""Headers of the compiled modules (``.pxd``), made from the annotations of their sources.

- ``int`` is a ``long long`` in C, ``float`` a ``double``, ``bool`` a ``bint``; ``cython.X`` is X.
  A struct of the kernel is passed by its address. Lists, tuples, dicts and bytes are known as such,
  and a class that is compiled or inherits one that is. All else, and a number or None, is any
  object.
- A function that begins with an underscore is C's alone, and one that takes a message's struct. All
  others are Python's too. One that C cannot call is left out: its arguments go by name only, or it
  holds a generator.
- In ``core`` a function that takes and returns none of Python's objects is C's alone, unless it is
  a method without an underscore. It runs without the interpreter, but where it makes an array or an
  object; it cannot raise, unless it calls a method that makes one.
  Elsewhere one that handles numbers and arrays alone cannot raise.
- An attribute is what it is annotated with, or else its first value. Python sees it if it has no
  underscore and is no memory.
- A local variable that is annotated is that. A number in capitals is C's alone if it is imported
  from another module or begins with an underscore, and is written out.
"""

import ast
import builtins
import math
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

CORE = Path(__file__).parent.parent
PACKAGE = CORE.parent
CIMPORTS = "cython.cimports."
OURS = f"{PACKAGE.name}."
READERS = {
    "lidar": ("loops", "voxel_map"),
    "logs": ("csv_lines", "dataflash_search", "json_objects", "tlog_search", "ulog_search"),
    "mavlink": ("dejitter", "payload", "reader", "sequence", "timebase"),
    "mavlink.decode": ("fix", "preference", "state"),
    "nav": ("inertial_pair", "inertial_unit", "lanes", "repetition"),
}
"""What is compiled beside the kernel."""
OVERLAY, MESSAGES = "core.memory.overlay", "mavlink.record"
STRUCTS = [f"core.memory.{name}" for name in ("bank", "parameters", "scratch", "state")]
VOID, OBJECT = "void {}", "object {}"
NUMBERS = {"int": "cython.longlong {}", "float": "double {}", "bool": "bint {}"}
PYTHONS = ("list", "tuple", "dict", "bytes")
PASSED = {
    **NUMBERS,
    **{name: f"{name} {{}}" for name in PYTHONS},
    "Dcm": "double {}[3][3]",
    "Square": "double {}[N][N]",
    "Numbers": "double[::1] {}",
    "Vector": "Vector {}",
    "Structs": "Structs {}",
    "Bytes": "const cython.uchar[::1] {}",
    "bytearray": "cython.uchar[::1] {}",
    "array": "cython.longlong[::1] {}",
}
"""What an annotation is in C, around a name."""
SHAPES = {"Column": "::1", "Table": ":, ::1"}
ELEMENTS = {"float64": "double", "float32": "float", "int64": "longlong", "int32": "int"}
ELEMENTS |= {"int16": "short", "uint16": "ushort", "int8": "schar", "uint8": "uchar"}
"""Of an array of NumPy, as ``cython`` names it."""


def kernel_modules() -> list[str]:
    """Return the compiled modules of the kernel: those that name others as the compiler does."""
    found = {path: path.read_text(encoding="utf-8") for path in CORE.rglob("*.py")}
    names = [path for path, text in found.items() if f"\nfrom {CIMPORTS}" in text]
    return sorted(".".join(path.relative_to(CORE).with_suffix("").parts) for path in names)


def compiled_modules() -> list[str]:
    """Return all modules that are compiled, as far as their sources are here."""
    others = [f"{room}.{name}" for room, names in READERS.items() for name in names]
    names = [*(f"core.{name}" for name in kernel_modules()), *others]
    return [name for name in names if path_of(name).exists()]


def path_of(name: str) -> Path:
    """Return the source of a module of the package."""
    return PACKAGE / f"{name.replace('.', '/')}.py"


def signatures(name: str, text: str) -> str:
    """Return the ``.pxd`` of a module: what its signatures name, its numbers, classes, functions.

    Args:
        name: Of the module, in the package.
        text: Its source.

    Raises:
        TypeError: An annotation is missing, or nobody knows what it means.
    """
    return _Module(name, text).header()


class _Module:
    """A module as it is written, and its header."""

    def __init__(self, name: str, text: str) -> None:
        self.name, self.body = name, ast.parse(text).body
        room, _, last = name.rpartition(".")
        self.is_kernel = name.startswith("core.")
        self.is_compiled = last in READERS.get(room, ()) or f"\nfrom {CIMPORTS}" in text
        self.classes = {one.name: one for one in self.body if isinstance(one, ast.ClassDef)}
        self.origin: dict[str, str] = {}
        """Module of each name that is imported, those of the compiler with a prefix."""
        self.numbers: dict[str, object] = {"math": math}
        self.numbers["__builtins__"] = {"float": float, "range": range}
        """What is assigned, as far as it is written out."""
        self.known = {*dir(builtins), *self.classes, "cython"}
        self.native = {"self", "cython", *("range", "len", "abs", "min", "max"), *NUMBERS}
        """Names that are no objects in C."""
        for node in self.body:
            if isinstance(node, ast.ImportFrom):
                module = str(node.module).replace(OURS, "", 1)
                self.origin |= {alias.asname or alias.name: module for alias in node.names}
            elif isinstance(node, ast.Import):
                self.known |= {alias.asname or alias.name for alias in node.names}
            elif isinstance(node, ast.Assign):
                self.known |= {ast.unparse(target) for target in node.targets}
                if isinstance(node.value, ast.Call) and "cython.declare" in ast.unparse(node):
                    node.value = node.value.args[-1]
                    self.native |= {ast.unparse(target) for target in node.targets}
                with suppress(NameError, AttributeError):
                    exec(compile(ast.Module([node], []), name, "exec"), self.numbers)
        self.known |= {*self.origin}
        self.needs: set[tuple[str, str]] = set()
        """Module and name of what the header names."""

    def module_of(self, name: str) -> str:
        """Return the module that a name is imported from."""
        return self.origin.get(name, "").removeprefix(CIMPORTS)

    def compiled(self, name: str) -> "tuple[_Module, str] | None":
        """Return module and name of a compiled class: this one, or the first that it inherits."""
        if name in self.classes:
            node = self.classes[name]
            bases = [self.compiled(ast.unparse(base)) for base in node.bases]
            if self.is_compiled and all(bases) and not node.decorator_list:
                return self, name
            return next((one for one in bases if one), None)
        origin = _read(self.module_of(name))
        return origin.compiled(name) if origin else None

    def header(self) -> str:
        """Return the header."""
        lines = [*self._numbers()]
        self.native |= {name for name, one in self.origin.items() if one.startswith(CIMPORTS)}
        self.native |= {line.split(" ")[-1] for line in lines}
        raising = self._raising(_functions(self), {})
        for node in self.body:
            if isinstance(node, ast.ClassDef):
                is_native = self.compiled(node.name) == (self, node.name)
                lines += self._class(node) if is_native else ()
            elif isinstance(node, ast.FunctionDef):
                lines += self._function(node, "", raising)
        head = [f"# Made from {self.name} by setup.py"]
        head += ["cimport cython"] if any("cython." in line for line in lines) else []
        for module in sorted({one for one, _ in self.needs} - {self.name}):
            names = ", ".join(sorted(name for one, name in self.needs if one == module))
            head.append(f"from {OURS}{module} cimport {names}")
        return "\n".join([*head, *lines]) + "\n"

    def _numbers(self) -> Iterator[str]:
        own = {name: one for name, one in self.numbers.items() if name.startswith("_")}
        imported = {name: _read(module) for name, module in self.origin.items()}
        own |= {name: one.numbers.get(name) for name, one in imported.items() if one}
        for name, number in own.items():
            if name.isupper() and type(number).__name__ in NUMBERS:
                yield "cdef " + NUMBERS[type(number).__name__].format(name)

    def _class(self, node: ast.ClassDef) -> Iterator[str]:
        """Yield a class: its attributes, and its methods."""
        bases = [self._type(base, node.name).format("").strip() for base in node.bases]
        yield f"cdef class {node.name}({', '.join(bases)}):".replace("()", "")
        kinds = self.attributes(node)
        for name, kind in kinds.items():
            is_memory = any(mark in kind for mark in ("*", "[:", "][", "cython.p_"))
            is_hidden = name.startswith("_") or is_memory or self._is_struct(kind[:-3])
            yield f"    cdef {'' if is_hidden else 'public '}{kind.format(name)}"
        raising = self._raising(_functions(node), self._inherited(node) | kinds)
        parts = [self._function(one, node.name, raising) for one in _functions(node)]
        lines = [line for part in parts for line in part]
        yield from (f"    {line}" for line in lines or ([] if kinds else ["pass"]))

    def attributes(self, node: ast.ClassDef) -> dict[str, str]:
        """Return what the attributes of a class are in C, without those that it inherits."""
        said: dict[str, str] = {}
        firsts: dict[str, str] = {}
        for hint in (one for one in node.body if isinstance(one, ast.AnnAssign)):
            name = ast.unparse(hint.target)
            said[name] = self._type(hint.annotation, f"{node.name}.{name}")
        for method in _functions(node):
            for part in ast.walk(method):
                if isinstance(part, ast.AnnAssign) and (name := _own(part.target)):
                    said[name] = self._type(part.annotation, f"{node.name}.{name}")
                for name, first in _assigned(part):
                    if name not in firsts:
                        firsts[name] = self._value(first, method)
        inherited = self._inherited(node)
        return {name: kind for name, kind in (firsts | said).items() if name not in inherited}

    def _inherited(self, node: ast.ClassDef) -> dict[str, str]:
        found: dict[str, str] = {}
        for base in (self.compiled(ast.unparse(one)) for one in node.bases):
            if base:
                inside = base[0].classes[base[1]]
                found |= base[0].attributes(inside) | base[0]._inherited(inside)
        return found

    def _value(self, value: ast.expr, method: ast.FunctionDef) -> str:
        """Return what an attribute is in C whose first value this is."""
        match value:
            case ast.UnaryOp():
                return self._value(value.operand, method)
            case ast.Constant():
                return NUMBERS.get(type(value.value).__name__, OBJECT)
            case ast.BinOp(left=ast.List(elts=[element]), right=size):  # [0.0] * 3
                return self._value(element, method).replace("{}", f"{{}}[{ast.unparse(size)}]")
            case ast.ListComp(generators=[ast.comprehension(iter=ast.Call(args=[size]))]):
                return self._value(value.elt, method).replace("{}", f"{{}}[{ast.unparse(size)}]")
            case ast.List() | ast.Tuple() | ast.Dict():
                return PASSED[type(value).__name__.lower()]
            case ast.Name():
                hints = {arg.arg: arg.annotation for arg in method.args.args}
                if value.id in hints:
                    return self._type(hints[value.id], f"{method.name}, {value.id}")
                return NUMBERS.get(type(self.numbers.get(value.id)).__name__, OBJECT)
            case ast.Call(func=ast.Attribute(value=ast.Name(id="np"), attr="zeros" | "full")):
                kinds = [ast.unparse(one.value) for one in value.keywords if one.arg == "dtype"]
                shape = SHAPES["Table" if isinstance(value.args[0], ast.Tuple) else "Column"]
                item = ELEMENTS[kinds[0].removeprefix("np.") if kinds else "float64"]
                return f"cython.{item}[{shape}] {{}}"
            case ast.Call(func=ast.Name(id=name) as kind):
                if self.module_of(name) == OVERLAY and (overlay := _read(OVERLAY)):
                    (laid,) = (one for one in _functions(overlay) if one.name == name)
                    struct = ast.unparse(laid.returns or laid)
                    self.needs.add((overlay.module_of(struct), struct))
                    return f"{struct} *{{}}"
                if self.compiled(name) or name in NUMBERS or self._is_struct(name):
                    return self._type(kind, method.name).replace("*", "")
        return OBJECT

    def _function(self, node: ast.FunctionDef, owner: str, raising: set[str]) -> Iterator[str]:
        """Yield a function's declaration, unless it stays Python's alone."""
        if node.name.startswith("__") or not _is_callable(node):
            return
        where = f"{owner}.{node.name}".lstrip(".")
        args = node.args.args[1:] if owner else node.args.args
        kinds = [self._type(arg.annotation, f"{where}, {arg.arg}") for arg in args]
        returned = self._type(node.returns, f"{where}, returned")
        words = {kind.split(" ")[0] for kind in (*kinds, returned)}
        has_objects = bool(words & {"object", *PYTHONS})
        is_native = self.is_kernel and not has_objects
        is_cdef = node.name.startswith("_") or (is_native and not owner)
        is_cdef |= any((MESSAGES, word) in self.needs for word in words)
        ending = ""
        if is_cdef and is_native:
            ending = " except -1" if node.name in raising else " noexcept"
            ending += " with gil" if self._makes_object(node) else " nogil"
            if returned == VOID and node.name in raising:
                returned = "int {}"
        elif is_cdef and not has_objects and node.name not in raising:
            ending = " noexcept"
        elif returned == VOID:
            returned = OBJECT
        passed = [kind.format(arg.arg) for kind, arg in zip(kinds, args, strict=True)]
        first = len(passed) - len(node.args.defaults)
        passed = [*passed[:first], *(f"{one}=*" for one in passed[first:])]
        local = [
            f"{one.target.id}={kind.removesuffix(' {}')}"
            for one in ast.walk(node)
            if isinstance(one, ast.AnnAssign) and isinstance(one.target, ast.Name)
            if (kind := self._type(one.annotation, f"{where}, {one.target.id}")) != OBJECT
        ]
        if local:
            yield f"@cython.locals({', '.join(local)})"
        declared = f"{node.name}({', '.join(['self', *passed] if owner else passed)})"
        yield f"{'cdef' if is_cdef else 'cpdef'} {returned.format(declared)}{ending}"

    def _type(self, hint: ast.expr | None, where: str) -> str:
        """Return what an annotation is in C, around a name."""
        match hint:
            case None:
                raise TypeError(f"{self.name}: {where}: has no annotation")
            case ast.Constant(value=None):
                return VOID
            case ast.BinOp():
                one, other = self._type(hint.left, where), self._type(hint.right, where)
                return OBJECT if other != VOID or one in NUMBERS.values() else one
            case ast.Attribute(value=ast.Name(id="cython")):
                return f"cython.{hint.attr} {{}}"
            case ast.Attribute(value=ast.Name(id="record")):
                self.needs.add((MESSAGES, hint.attr))
                return f"{hint.attr} {{}}"
            case ast.Subscript(value=ast.Name(id="Const")):
                return f"const {self._type(hint.slice, where)}"
            case ast.Subscript(value=ast.Name(id=name)) if name in SHAPES:
                element = ast.unparse(hint.slice).removeprefix("np.")
                if element in ELEMENTS:
                    return f"cython.{ELEMENTS[element]}[{SHAPES[name]}] {{}}"
                return self._type(hint.slice, where).replace(" ", f"[{SHAPES[name]}] ")
            case ast.Subscript():
                return self._type(hint.value, where)
        name = ast.unparse(hint)
        module = self.module_of(name)
        self.needs |= {("core.memory.enums", "N")} if name == "Square" else set()
        if module.startswith("core.memory."):
            self.needs.add((module, name))
        if name in PASSED:
            return PASSED[name]
        if self._is_struct(name):
            return f"{name} *{{}}"
        if name.partition(".")[0] not in self.known:
            raise TypeError(f"{self.name}: {where}: nobody knows {name}")
        if found := self.compiled(name):
            self.needs.add((found[0].name, found[1]))
            return f"{found[1]} {{}}"
        return OBJECT

    def _raising(self, functions: list[ast.FunctionDef], kinds: dict[str, str]) -> set[str]:
        """Return which functions may raise: those that handle objects, and those that call them."""
        ours = {one.name for one in functions if _is_callable(one)}
        has = self._makes_object if self.is_kernel else self._has_object
        raising = {one.name for one in functions if has(one, ours, kinds)}
        while more := {one.name for one in functions if _called(one) & raising} - raising:
            raising |= more
        return raising

    def _has_object(self, node: ast.FunctionDef, ours: set[str], kinds: dict[str, str]) -> bool:
        """Return whether a function handles more than numbers and arrays."""
        known = self.native | ours | {arg.arg for arg in node.args.args}
        for one in (one for part in node.body for one in ast.walk(part)):
            match one:
                case ast.Name(id=name, ctx=ast.Store()):
                    known.add(name)
                case ast.Name(id=name) if name not in known:
                    return True
                case ast.Attribute(value=ast.Name(id="self"), attr=name):
                    kind = kinds.get(name, "")
                    is_number = "[" in kind or kind.startswith(("cython.", "double", "bint"))
                    if not is_number and name not in ours:
                        return True
                case ast.Attribute(value=ast.Name(id="cython")) | ast.Attribute(attr="shape"):
                    pass
                case ast.Attribute():
                    return True
        return False

    def _makes_object(self, node: ast.FunctionDef, *_: object) -> bool:
        """Return whether a function makes an array, or an object of a compiled class."""
        return any(one.startswith("np.") or self.compiled(one) for one in _called(node))

    def _is_struct(self, name: str) -> bool:
        return self.module_of(name) in STRUCTS


@cache
def _read(name: str) -> _Module | None:
    """Return a module of the package; None: it is none."""
    path = path_of(name)
    return _Module(name, path.read_text(encoding="utf-8")) if path.exists() else None


def _is_callable(node: ast.FunctionDef) -> bool:
    """Return whether C can call a function."""
    args, others = node.args, (ast.GeneratorExp, ast.Lambda, ast.FunctionDef, ast.Yield)
    is_closed = any(isinstance(one, others) for one in ast.walk(node) if one is not node)
    return not (is_closed or node.decorator_list or args.kwonlyargs or args.vararg or args.kwarg)


def _functions(node: ast.ClassDef | _Module) -> list[ast.FunctionDef]:
    return [one for one in node.body if isinstance(one, ast.FunctionDef)]


def _called(node: ast.FunctionDef) -> set[str]:
    """Return what a function calls of its own module or object."""
    calls = [one.func for one in ast.walk(node) if isinstance(one, ast.Call)]
    return {_own(one) or ast.unparse(one) for one in calls}


def _own(target: ast.expr) -> str:
    """Return the name of an attribute of ``self``; empty: it is none."""
    match target:
        case ast.Attribute(value=ast.Name(id="self")):
            return target.attr
    return ""


def _assigned(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield each attribute of ``self`` that a statement assigns, and the value."""
    for target in node.targets if isinstance(node, ast.Assign) else ():
        match target, node:
            case ast.Tuple(elts=targets), ast.Assign(value=ast.Tuple(elts=values)):
                pairs = [*zip(targets, values, strict=True)]
            case ast.Tuple(elts=targets), ast.Assign(value=value):
                pairs = [(one, value) for one in targets]
            case _, ast.Assign(value=value):
                pairs = [(target, value)]
        yield from ((name, value) for one, value in pairs if (name := _own(one)))
