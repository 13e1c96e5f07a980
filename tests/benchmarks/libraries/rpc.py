"""JSON-RPC 2.0: one line in, one answer out; sockets, turns, budgets and clients that flood are ours in any case."""

from __future__ import annotations

import json
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from emulator.config.budgets import loads_json
from emulator.process.clock import ThreadClock
from emulator.runtime import control
from emulator.runtime.control import ControlServer, OrderError
from tests.benchmarks.libraries.measure import Row, added, bounded, import_cost, lines, per_s, version_of

METHODS: dict[str, Callable[[Any], Any]] = {}
Answer = Callable[[bytes], "dict[str, Any] | None"]
CASES: list[tuple[bytes, int | None]] = [
    (b"\x00\xff garbage", -32700),
    (b"[1, 2]", -32600),
    (b'{"method": 3}', -32600),
    (b'{"id": 7, "method": "fly"}', -32601),
    (b'{"jsonrpc": "2.0", "id": 7, "method": "fly"}', -32601),
    (b'{"id": 7, "method": "status", "params": [1]}', -32602),
    (b'{"id": 7, "method": "status", "params": {"x": 1}}', -32602),
    (b'{"jsonrpc": "2.0", "id": 7, "method": "status", "params": {"x": 1}}', -32602),
    (b'{"jsonrpc": "2.0", "id": 7, "method": "refused"}', -32000),
    (b"[" * 5000, -32700),
    (b'{"id": 7, "method": "status"}', None),
    (b'{"jsonrpc": "2.0", "id": 7, "method": "status", "params": {}}', None),
]
"Requests of `tests/system/test_control.py`, the same with a version, and code of the answer; None: a result."
HOSTILE = {
    "6e4 brackets": "b'[' * 60000",
    "6e4 nested tables": "b'{\"a\":' * 12000",
    "number of 6e4 digits": 'b\'{"jsonrpc": "2.0", "method": "status", "id": \' + b\'9\' * 60000 + b\'}\'',
    "not UTF-8": "b'\\xff\\xfe'",
    "batch of 1200": 'b\'[\' + b\',\'.join([b\'{"jsonrpc": "2.0", "id": 1, "method": "status"}\'] * 1200) + b\']\'',
}


def _status(params: Any) -> object:
    if params:
        raise OrderError(control.BAD_PARAMS, "x; want nothing")
    return {"clock": "real"}


def _refused(params: Any) -> object:
    raise OrderError(control.REFUSED, "the run does not do that")


METHODS |= {"status": _status, "refused": _refused}


class _Run:
    def call(self, action: Callable[[], object]) -> Future[object]:
        done: Future[object] = Future()
        try:
            done.set_result(action())
        except OrderError as error:
            done.set_exception(error)
        return done


def ours() -> Answer:
    server = ControlServer.__new__(ControlServer)
    server.methods, server.run, server._processor = METHODS, _Run(), ThreadClock()
    return server.answer


def by_jsonrpcserver() -> Answer:
    from jsonrpcserver import Error, Success, dispatch_to_serializable

    def wrapped(method: Callable[[Any], Any]) -> Callable[..., Any]:
        def run(**params: Any) -> Any:
            try:
                return Success(method(params))
            except OrderError as error:
                return Error(error.code, str(error))

        return run

    methods = {name: wrapped(method) for name, method in METHODS.items()}
    return lambda line: dispatch_to_serializable(line, methods=methods, deserializer=loads_json)  # type: ignore


def by_json_rpc() -> Answer:
    from jsonrpc import JSONRPCResponseManager
    from jsonrpc.exceptions import JSONRPCDispatchException

    def wrapped(method: Callable[[Any], Any]) -> Callable[..., Any]:
        def run(**params: Any) -> Any:
            try:
                return method(params)
            except OrderError as error:
                raise JSONRPCDispatchException(error.code, str(error)) from None

        return run

    methods = {name: wrapped(method) for name, method in METHODS.items()}

    def answer(line: bytes) -> Any:
        found = JSONRPCResponseManager.handle(line, methods)
        return None if found is None else json.loads(found.json)

    return answer


LIBRARIES: dict[str, tuple[str, str, Callable[[], Answer]]] = {
    "jsonrpcserver": ("jsonrpcserver", "jsonrpcserver", by_jsonrpcserver),
    "json-rpc": ("json-rpc", "jsonrpc", by_json_rpc),
}
FRAMED = {"python-lsp-jsonrpc": "pylsp_jsonrpc.streams", "pygls": "pygls.server"}
"Frame each message by a Content-Length header, as editors do: no line that a shell can send; only their cost is told."


def hostile(name: str, line: bytes) -> str:
    """For `bounded`: the code or the number of results."""
    found: Any = (ours if name == "ours" else LIBRARIES[name][2])()(line)
    if isinstance(found, list):
        return f"{len(found)} results"
    return str(found["error"]["code"]) if found and "error" in found else "a result"


def _measured(name: str, make: Callable[[], Answer]) -> dict[str, str]:
    answer, good = make(), 0
    for line, code in CASES:
        try:
            found = answer(line)
        except Exception:
            continue
        error = (found or {}).get("error")
        good += bool(found) and (error["code"] if error else None) == code
    line = CASES[-1][0]
    found = {
        "our requests answered as now": f"{good} of {len(CASES)}",
        "answers/s": f"{per_s(lambda: answer(line)):.0f}",
    }
    for label, text in HOSTILE.items():
        call = f"tests.benchmarks.libraries.rpc:hostile({name!r}, {text})"
        found[label] = bounded(call).removeprefix("answers ")
    return found


def rows(tests: bool = False) -> list[Row]:
    """Ours, then every library."""
    replaced = lines(ControlServer.answer, control._request)
    every = lines(control)
    found = [Row("ours", {"lines to replace": f"{replaced} of {every}"} | _measured("ours", ours))]
    for name, (distribution, module, make) in LIBRARIES.items():
        version = version_of(distribution)
        if version is None:
            found.append(Row(name))
            continue
        cost = {"install": added(distribution), "import": import_cost(module, "import emulator.runtime.orders")}
        found.append(Row(f"{name} {version}", cost | {"lines of glue": str(lines(make))} | _measured(name, make)))
    for name, module in FRAMED.items():
        version = version_of(name)
        costs = {} if version is None else {"install": added(name)}
        if costs:
            costs["import"] = import_cost(module, "import emulator.runtime.orders")
        found.append(Row(f"{name} {version}" if version else name, costs))
    return found
