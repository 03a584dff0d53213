"""The tool that tests the tests: its faults, their draw, and its verdicts on a small package."""

import ast
import subprocess
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mutate
import pytest
from mutation.draw import drawn, mutations, source_mutations
from mutation.first import pytest_collection_modifyitems

ROOT = Path(__file__).parents[2]
CHANGES = [
    ("tie_rule", "return a < b", {"return a <= b"}),
    ("tie_rule", "return a < 0.5", set()),
    ("tie_rule", "return rng.random() < b", set()),
    ("comparison", "return a <= (b)", {"return a >= (b)"}),
    ("comparison", "return a is not None", {"return a is None"}),
    ("clause", "return a < b or c", {"return (a < b)", "return (c)"}),
    ("connective", "return a and not b", {"return a or not b"}),
    ("connective", "return (a > 0) & b", {"return (a > 0) | b"}),
    ("connective", "return a & b", set()),
    ("condition", "return a if b else c", {"return a if (not (b)) else c"}),
    ("sign", "return a * -b", {"return a / -b", "return a * (b)"}),
    ("sign", "a -= b", {"a += b"}),
    ("sign", "return a + 'text'", set()),
    ("number", "return a + 2", {"return a + 3"}),
    ("number", "return 2.0 * a", {"return 2.2 * a"}),
    ("number", "return a + 1e-9", set()),
    ("truth", "a = True", {"a = False"}),
    ("exchange", "a = draw(1); b = draw(2)", {"b = draw(2); a = draw(1)"}),
    ("exchange", "a = draw(1); b = draw(a)", set()),
    ("exchange", "return f(a, b, c)", {"return f(a, c, b)"}),
    ("exchange", "return min(b[0], c[0])", set()),
    ("order", "for i in range(a): b += i", {"for i in range(1, a): b += i"}),
    ("stale", "a = b", {"pass"}),
    ("stale", "new = b", set()),
    ("stale", "a[0] += b", {"pass"}),
    ("extreme", "return np.minimum(a, b)", {"return np.maximum(a, b)"}),
    ("index", "return a[2] + a[0]", {"return a[1] + a[0]", "return a[2] + a[1]"}),
    ("index", "for i in range(a): b[i] = 0", {"for i in range(a): b[i - 1] = 0"}),
]


def changed(code: str) -> dict[str, set[str]]:
    """What each operator makes of a module."""
    found: dict[str, set[str]] = {}
    for each in mutations("charms_bench/module.py", code.encode()):
        found.setdefault(each.operator, set()).add(each.applied(code.encode()).decode())
    return found


@pytest.mark.parametrize(("operator", "line", "expected"), CHANGES)
def test_an_operator_changes_code(operator: str, line: str, expected: set[str]) -> None:
    head = "def f(a, b, c):\n    "
    assert changed(head + line).get(operator, set()) == {head + each for each in expected}


@pytest.mark.parametrize(
    ("body", "matters"),
    [
        ("if g(i):\n            found = i", True),
        ("if g(i):\n            break", True),
        ("found += normal(a, 0, 1)", True),
        ("new = i\n        if g(i):\n            new = 0", False),
        ("for k in a:\n            break", False),
    ],
)
def test_a_loop_is_reversed_only_where_the_order_matters(body: str, matters: bool) -> None:
    code = f"def f(a, found):\n    for i in range(2, a):\n        {body}"
    backwards = code.replace("range(2, a)", "range(a - 1, 2 - 1, -1)")
    assert (backwards in changed(code)["order"]) == matters


def test_ways_out_are_dropped_unless_nothing_follows_or_a_loop_would_not_end() -> None:
    early = "def f(a):\n    if a:\n        return 1\n    return 2\n"
    assert changed(early)["way_out"] == {early.replace("return 1", "pass")}
    last = "def f(a):\n    if a:\n        return 1\n"
    endless = "def f(a):\n    while True:\n        if a:\n            break\n"
    assert "way_out" not in changed(last) | changed(endless)


def test_what_nobody_runs_or_everybody_reads_stays() -> None:
    code = '''"""1 < 2"""
Row = tuple[int, 3]
if TYPE_CHECKING:
    ONE = 1

def f(a: Literal[1]) -> Literal[2]:
    """3 < 4"""
    assert a < 5
    raise ValueError(f"{a + 6}", 7)

def title(a):
    return a + 8
'''
    assert changed(code) == {}


def test_kernels_are_compiled_functions_and_the_constants_that_they_read() -> None:
    code = b"READ = 1\nOTHER = 2\n@compiled\ndef f(a): return a + READ\ndef g(): return 3\n"
    kernels = {each.before: each.is_kernel for each in mutations("charms_bench/m.py", code)}
    assert kernels == {"1": True, "2": False, "+": True, "3": False}


def test_each_mutation_of_the_project_parses_and_differs_in_one_place() -> None:
    every = source_mutations(ROOT, ["charms_bench/recording", "charms_bench/statistics"])
    for mutation in drawn(every, 3, 100):
        code = (ROOT / mutation.path).read_bytes()
        after = mutation.applied(code)
        assert ast.dump(ast.parse(after)) != ast.dump(ast.parse(code))
        assert code[mutation.start : mutation.end] == mutation.before.encode()
        assert after.startswith(code[: mutation.start])
        assert after.endswith(code[mutation.end :])


def test_a_draw_depends_on_its_seed_and_is_spread() -> None:
    every = source_mutations(ROOT, ["charms_bench/recording", "charms_bench/metrics"])
    first = drawn(every, 1, 40)
    assert drawn(every[::-1], 1, 40) == first
    assert drawn(every, 2, 40) != first
    operators = Counter(each.operator for each in first)
    assert max(operators.values()) - min(operators.values()) <= 1
    assert max(Counter(each.path for each in first).values()) <= 3


@pytest.mark.parametrize(
    ("module", "expected"),
    [("roads/u_turn.py", "dcab"), ("engine/motion.py", "bacd"), ("", "abcd")],
)
def test_tests_that_are_named_like_a_module_run_first(
    module: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {"a": "[other]", "b": "_straight[5]", "c": "[merge-v0]", "d": "[u-turn-v1]"}
    items: list[Any] = [SimpleNamespace(nodeid=name, letter=each) for each, name in names.items()]
    monkeypatch.setenv("MUTATED", f"charms_bench/{module}" if module else "")
    pytest_collection_modifyitems(items)
    assert "".join(item.letter for item in items) == expected


def test_what_is_listed_as_equivalent_is_a_mutation_and_has_a_reason() -> None:
    for line in mutate.EQUIVALENT.read_text(encoding="utf-8").splitlines():
        key, _, reason = line.partition("  # ")
        path = key.partition(" ")[0]
        assert key in {each.key for each in mutations(path, (ROOT / path).read_bytes())}
        assert reason


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A package with a function that a test calls, and one that none does."""
    files = {
        "charms_bench/__init__.py": "",
        "charms_bench/toy/__init__.py": "",
        "charms_bench/toy/speeds.py": "def slower(one, other):\n    return min(one, other)\n\n\n"
        "def unseen(gap):\n    return -gap\n",
        "tests/toy/test_a.py": "def test_a():\n    pass\n",
        "tests/toy/test_speeds.py": "from charms_bench.toy.speeds import slower\n\n\n"
        "def test_speeds():\n    assert slower(1, 2) == 1\n",
    }
    for name, text in files.items():
        path = tmp_path / "checkout" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    subprocess.run(["git", "init", "--quiet", tmp_path / "checkout"], check=True)
    return tmp_path / "checkout"


def test_a_fault_is_killed_if_a_test_notices_it_and_survives_if_none_does(
    checkout: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["rest", "--source", str(checkout), "--folder", str(tmp_path / "mutated")]
    before = (checkout / "charms_bench/toy/speeds.py").read_bytes()
    mutate.main([*command, "--workers", "2"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("tests/toy, without a mutation: passed")
    killed, survived = sorted(lines[1:3])
    assert "speeds.py:2, slower, extreme: min -> max: killed tests/toy/test_speeds.py::" in killed
    assert "speeds.py:6, unseen, sign: -gap -> (gap): SURVIVED" in survived
    assert lines[3:4] == ["1 SURVIVED, 1 killed"]
    assert (checkout / "charms_bench/toy/speeds.py").read_bytes() == before
    mutate.main(command)
    assert capsys.readouterr().out.splitlines() == lines[3:]


def test_a_test_that_does_not_end_notices_the_fault(checkout: Path, tmp_path: Path) -> None:
    (checkout / "tests/toy/test_speeds.py").write_text(
        "from charms_bench.toy.speeds import slower\n\n\n"
        "def test_speeds():\n    while slower(1, 2) == 2:\n        pass\n"
    )
    runner = mutate.Runner(mutate.copied(checkout, tmp_path), [], {})
    (slower,) = (each for each in source_mutations(checkout, ["charms_bench"]) if each.line == 2)
    assert runner.mutated(slower, ["tests/toy"], 3.0).verdict == "timed out"


def test_tests_that_fail_without_a_fault_are_an_error(checkout: Path, tmp_path: Path) -> None:
    (checkout / "tests/toy/test_a.py").write_text("def test_a():\n    assert False\n")
    with pytest.raises(SystemExit, match=r"tests/toy fails without a mutation: .*test_a"):
        mutate.main(["rest", "--source", str(checkout), "--folder", str(tmp_path / "mutated")])
