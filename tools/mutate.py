"""Whether the tests notice faults in the code: `python tools/mutate.py kernels --folder FOLDER`.

It draws small changes of the source code, applies each to a copy of the checkout, and runs tests
there. `kernels` are changes of compiled code, and tests/golden has to notice them; `rest` are all
others, which the tests of their own room have to notice.

FOLDER keeps the copies and `results.jsonl`. Mutations that have a result for the same code and
tests do not run again. Those in tools/mutation/equivalent.txt, which nothing can notice, never run.
"""

import argparse
import json
import shlex
import signal
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from mutation.draw import Mutation, drawn, source_mutations
from mutation.runner import TOOLS, Ran, Runner, copied, tests_of

SOURCES = ("charms_bench", "baselines", "agents")
EQUIVALENT = TOOLS / "mutation" / "equivalent.txt"
COMPILING_S = 300
"""How long it may take to compile what a fault concerns, on top of three times the usual time."""


def described(mutation: Mutation) -> str:
    """A line about a mutation."""
    change = " ".join(f"{mutation.before} -> {mutation.after}".split())
    return f"{mutation.path}:{mutation.line}, {mutation.function}, {mutation.operator}: {change}"


def chosen(root: Path, which: str, count: int, seed: int, under: Sequence[str]) -> list[Mutation]:
    """The mutations that are drawn, of kernels or of the rest, from modules under some paths."""
    found = source_mutations(root, [each for each in SOURCES if (root / each).is_dir()])
    # The golden tests do not train, so compiled code of the training belongs to the rest.
    pool = [
        each
        for each in found
        if (each.is_kernel and not each.path.startswith("agents/")) == (which == "kernels")
        and each.path.startswith(tuple(under))
    ]
    return drawn(pool, seed, count)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("which", choices=("kernels", "rest"))
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--source", type=Path, default=TOOLS.parent, metavar="CHECKOUT")
    parser.add_argument("--against", nargs="+", metavar="TEST", help="tests in place of the usual")
    parser.add_argument("--under", nargs="+", default=[""], metavar="PATH", help="modules")
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--list", action="store_true", help="list the mutations and run none")
    parser.add_argument("--pytest", type=shlex.split, default=[], help="arguments of pytest")
    options = parser.parse_args(arguments)
    equivalent = {
        line.partition("  # ")[0] for line in EQUIVALENT.read_text(encoding="utf-8").splitlines()
    }
    picked = chosen(options.source, options.which, options.count, options.seed, options.under)
    todo = [each for each in picked if each.key not in equivalent]
    if options.list:
        print(*map(described, sorted(todo)), sep="\n")
        return
    if options.folder is None:
        parser.error("--folder is missing")
    folder = options.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    base = copied(options.source.resolve(), folder)
    # Kernels compile a little faster so, and have the same bits; at 0, numba cannot keep them.
    variables = {"NUMBA_OPT": "1"} if options.which == "kernels" else {}
    runner = Runner(base, ["-m", "not slow", *options.pytest], variables)
    try:
        evaluate(runner, todo, options)
    except KeyboardInterrupt:
        runner.stop()
        sys.exit("interrupted; the same command goes on")


def evaluate(runner: Runner, todo: Sequence[Mutation], options: argparse.Namespace) -> None:
    """Runs the tests without mutations, then with each, and prints what they find."""
    results = runner.base.parent / "results.jsonl"
    lines = results.read_text(encoding="utf-8").splitlines() if results.exists() else []
    known = {tuple(each["key"]): Ran(*each["ran"]) for each in map(json.loads, lines)}

    def key(tests: list[str], mutation: Mutation | None = None) -> tuple[Any, ...]:
        change = (mutation.key, mutation.start) if mutation else ("", 0)
        return runner.base.name, " ".join([*tests, *options.pytest]), *change

    def keep(of: tuple[Any, ...], ran: Ran, line: str) -> Ran:
        known[of] = ran
        with results.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": of, "ran": ran, "line": line}) + "\n")
        print(f"{line}: {ran.verdict} {ran.by} ({ran.seconds:.0f} s)", flush=True)
        return ran

    usual = options.against or (["tests/golden"] if options.which == "kernels" else None)
    of_each = {each: usual or tests_of(each.path, runner.base / "checkout") for each in todo}
    for tests in sorted({tuple(each) for each in of_each.values()}):
        if key([*tests]) not in known:
            ran = runner.run(runner.base, [*tests])
            if ran is None or ran.verdict != "passed":
                sys.exit(f"{' '.join(tests)} fails without a mutation: {ran and ran.by}")
            keep(key([*tests]), ran, f"{' '.join(tests)}, without a mutation")
    pool = ThreadPoolExecutor(options.workers)
    futures = {}
    for mutation, tests in of_each.items():
        if key(tests, mutation) not in known:
            limit_s = COMPILING_S + 3 * known[key(tests)].seconds
            futures[pool.submit(runner.mutated, mutation, tests, limit_s)] = mutation
    try:
        for future in as_completed(futures):
            if ran := future.result():
                mutation = futures[future]
                keep(key(of_each[mutation], mutation), ran, described(mutation))
    except BaseException:
        runner.stop()
        pool.shutdown(cancel_futures=True)
        raise
    verdicts = Counter(known[key(tests, each)].verdict for each, tests in of_each.items())
    print(", ".join(f"{count} {verdict}" for verdict, count in sorted(verdicts.items())))
    for mutation, tests in of_each.items():
        if known[key(tests, mutation)].verdict == "SURVIVED":
            print(f"survived: {described(mutation)}")


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    main()
