"""Rules of parameters, with texts that keep to them and texts that do not."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """A parameter with a rule."""

    kind: str
    default: str
    meaning: str
    must_be: str
    """What messages say."""
    allowed: tuple[str, ...]
    refused: tuple[str, ...]


CASES = [
    Case("int", "3", "segments of the robot, 1 to 6", "1 to 6", ("1", "6", "+2"), ("-4", "0", "7")),
    Case("int", "0", "seed, at least 0", "at least 0", ("0", str(2**60 + 1)), ("-1",)),
    Case("float", "1.0", "noise, at least 0 [mT]", "at least 0", ("0", "1e-3", "1e20"), ("-1e-9", "nan", "inf")),
    Case("float", "1.0", "noise, above 0 [mT]", "above 0", ("1e-300", "5"), ("0", "-0", "-inf")),
    Case("float", "1.0", "how long it takes, at most 10 [s]", "at most 10", ("10", "-1"), ("10.5",)),
    Case(
        "float", "1.0", "when, above 0 and below 10 [s]", "above 0 and below 10",
        ("0.1", "9.99"), ("0", "10", "11"),
    ),
    Case(
        "float", "7.1e-4", "noise, one of: 7.1e-4, 0.02 [mT]", "one of: 7.1e-4, 0.02", ("0.00071", "2e-2"), ("0.03",)
    ),
    Case(
        "str", '"released"', "ring, one of: released, published", "one of: released, published",
        ("published",), ("other", ""),
    ),
    Case(
        "str", '"none"', 'which, one of: none, "none, not zeroed", n_e=(1,0,0)',
        'one of: none, "none, not zeroed", n_e=(1,0,0)',
        ("none, not zeroed", "n_e=(1,0,0)"), ("not zeroed", "n_e=(1"),
    ),
    Case(
        "list", "[4]", "failed sensors, each once, 1 to 12",
        "a list of one or more whole numbers, each 1 to 12, none of them twice",
        ("[1, 12]", "[ 3 ]"), ("[]", "[0]", "[1, 13]", "[a]", "[1.5]", "[1.0]", "[1, 1]", "[[1]]", "[null]"),
    ),
    Case(
        "list", "[1.0]", "noises, when empty none, above 0 [mT]", "a list of values, each above 0",
        ("[]", "[1, 2e-3]", "[1, 1]"), ("[0]", "[1, .inf]", "[1, .nan]", "['1']"),
    ),
    Case(
        "list", "[80.0, 80.0]", "links, base to tip, 2 values, above 0 [mm]", "a list of 2 values, each above 0",
        ("[1, 1]",), ("[]", "[1]", "[1, 2, 3]", "[1, -1]"),
    ),
    Case(
        "list",
        "[13.0]",
        "lengths, 13.0 among them, each once, above 0 [mm]",
        "a list of one or more values, 13 among them, each above 0, none of them twice",
        ("[13, 14]", "[12, 13.0]"),
        ("[14]", "[]", "[13, -1]", "[13, 13.0]"),
    ),
    Case(
        "list", '["multipole"]', "models, one of: fast network, multipole",
        "a list of one or more of: fast network, multipole, none of them twice",
        ("[fast network]", "[multipole, fast network]"), ("[fast]", "[[multipole]]", "[]", "[multipole, multipole]"),
    ),
    Case(
        "list", "[0, 1]", "seeds, when empty none, one of: 0, 1, 2", "a list of any of: 0, 1, 2, none of them twice",
        ("[]", "[2, 0]"), ("[3]", "[0.0]", "[true]", "[0, 0]"),
    ),
]  # fmt: skip
