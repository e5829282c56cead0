"""Measure what costs how much on this computer: results/bench*.csv, and all rows in data/benchmark*.csv (minutes).

A target that is missed is a result like any other: the exit status is 0.
"""

from edition1.files import write_whole
from edition1_companion.book.project import find_project, shown
from edition1_companion.pages.performance.tables import with_targets

from bench.capabilities import benchmark
from bench.recorder import recorder_table


def main() -> int:
    """Measure, write and print."""
    project = find_project()
    table, points = benchmark(project.data / "networks")
    recorder = recorder_table()
    for path, part in (
        (project.results / "bench.csv", with_targets(table)),
        (project.results / "bench_recorder.csv", recorder),
        (project.data / "benchmark.csv", table),
        (project.data / "benchmark_scaling.csv", points),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, part.to_csv(index=False, float_format="%.4g", lineterminator="\n"))
        print(shown(path))
    print(with_targets(table).drop(columns=["error", "note"]).to_string(index=False))
    print(recorder.drop(columns="note").to_string(index=False))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
