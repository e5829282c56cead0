"""Make the archive of the project, ``make artifact``: sources, site, wheel, and metadata in one sealed zip.

``python scripts/artifact.py --measure`` instead writes what each page took in the build before, book/measured.csv.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pandas as pd
import yaml
from llvmlite.binding import get_host_cpu_name

from repro_companion import build as book
from repro_companion.artifact_page import MEASURED
from repro_companion.compare import CRATE, compare_with_head
from repro_companion.run import RunFailed, digest, project_folder, read_record, require

OUT = Path("build/artifact")
FIRST_DAY = (1980, 1, 1, 0, 0, 0)
"""The time of every file in a zip: the earliest that its format knows."""
TYPES = {
    ".csv": "text/csv",
    ".ipynb": "application/x-ipynb+json",
    ".lock": "text/plain",
    ".py": "text/x-python",
}


def main() -> int:
    """Make the archive, or measure; return 0, or 1 where something failed."""
    try:
        asked = sys.argv[1:]
        require(asked in ([], ["--measure"]), "options", "scripts/artifact.py", "none, or --measure", asked)
        print((measure if asked else make)(project_folder()))
    except (RunFailed, ValueError, subprocess.CalledProcessError) as failure:
        print(failure, file=sys.stderr)
        return 1
    return 0


def make(root: Path) -> str:
    """Build everything, seal it, and compare the tables in the unpacked archive; return where it lies."""
    out = root / OUT
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    # Tables and site of an archive are those without recordings, also where some are found.
    os.environ["REPRO_DATA_DIR"] = str(out / "no-recordings")
    if book.main([]):
        raise RunFailed("The book was not built, so there is no archive.")
    if (root / ".git").exists() and (moved := compare_with_head(root).found):
        raise RunFailed("\n".join([*moved, "Commit these tables first, or find out why they differ."]))
    sources = {name: root / name for name in listed(root)}
    wheel = built_wheel(sources, out)
    sources[wheel.name] = wheel
    for name, content in {"codemeta.json": codemeta(root), CRATE: crate(root)}.items():
        sources[name] = out / name
        sources[name].write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    site = root / "book/_build/html"
    sources |= {
        f"site/{path.relative_to(site).as_posix()}": path for path in site.rglob("*") if path.is_file()
    }
    refuse_recordings(root, sources)
    archive = sealed(sources, out / f"repro-{codemeta(root)['version']}.zip")
    print(compared(archive))
    return f"{archive.relative_to(root)}  ({archive.stat().st_size / 1e6:.1f} MB, {len(sources)} files)"


def listed(root: Path) -> list[str]:
    """Return the files of the project: those that git knows or, without git, those that it would not ignore."""
    if (root / ".git").exists() and shutil.which("git"):
        command = ["git", "-C", root, "ls-files", "-z"]
        names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
        return sorted(name for name in names if (root / name).is_file())
    return left_without_git(root)


def left_without_git(root: Path) -> list[str]:
    """Return the files that .gitignore leaves."""
    patterns = (root / ".gitignore").read_text(encoding="utf-8").replace("/\n", "\n").split()
    names = (path.relative_to(root).as_posix() for path in root.rglob("*") if path.is_file())
    return sorted(name for name in names if not is_ignored(name, patterns))


def is_ignored(name: str, patterns: list[str]) -> bool:
    """Return whether a pattern of .gitignore leaves a file out: one that begins with a stroke starts at the top."""
    below = any(fnmatchcase(part, pattern) for part in name.split("/") for pattern in [*patterns, ".git"])
    return below or any(f"/{name}/".startswith(f"{pattern}/") for pattern in patterns)


def built_wheel(sources: Mapping[str, Path], out: Path) -> Path:
    """Build the wheel from a copy of the sources, so that nothing else gets into it; return where it lies."""
    with tempfile.TemporaryDirectory() as folder:
        for name, path in sources.items():
            (Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, Path(folder) / name)
        pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        epoch = os.environ | {"SOURCE_DATE_EPOCH": "315532800"}
        subprocess.run([*pip, "--wheel-dir", out, folder], env=epoch, check=True)
    return next(out.glob("*.whl"))


def codemeta(root: Path) -> dict[str, Any]:
    """Return what catalogues of software ask for, from pyproject.toml and CITATION.cff."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = yaml.safe_load((root / "CITATION.cff").read_text(encoding="utf-8"))
    addresses = {"codeRepository": "Repository", "issueTracker": "Issues", "softwareHelp": "Documentation"}
    systems = [text.rpartition(" :: ")[2] for text in project["classifiers"] if "Operating System" in text]
    return {
        "@context": "https://w3id.org/codemeta/3.0",
        "@type": "SoftwareSourceCode",
        "name": cited["title"],
        "identifier": project["name"],
        "description": project["description"],
        "version": cited["version"],
        "datePublished": str(cited["date-released"]),
        "license": f"https://spdx.org/licenses/{cited['license']}",
        "author": [{"@type": "Organization", "name": one["name"]} for one in cited["authors"]],
        "keywords": project["keywords"],
        "programmingLanguage": "Python",
        "runtimePlatform": f"Python {project['requires-python']}",
        "operatingSystem": systems,
        "softwareRequirements": project["dependencies"],
        "referencePublication": [
            {"@type": "ScholarlyArticle", "name": paper["title"], "datePublished": str(paper["year"])}
            | ({"@id": f"https://doi.org/{paper['doi']}"} if "doi" in paper else {})
            for paper in cited["references"]
        ],
        **{
            key: project["urls"][name]
            for key, name in addresses.items()
            if "OWNER" not in project["urls"][name]
        },
    }


def crate(root: Path) -> dict[str, Any]:
    """Return the RO-Crate of the tables: each with its hash, the run that wrote it, and what the run read."""
    about = codemeta(root)
    inputs = [{"@id": "src/"}, {"@id": "data/"}, {"@id": "requirements.lock"}]
    tables = [f"results/{path.name}" for path in sorted((root / "results").glob("*.csv"))]
    runs, tools = [], ["src/repro_companion/scorecard.py"]
    for notebook in sorted((root / "notebooks").glob("*.ipynb")):
        record = read_record(root / "book/notebooks" / notebook.name) or {"results": {}}
        changed = [name for name, was in record["results"].items() if digest(root / "results" / name) != was]
        if changed or not record["results"]:
            raise RunFailed(
                f"{notebook.name} has not written {', '.join(changed) or 'its tables'}: make book"
            )
        tools.append(f"notebooks/{notebook.name}")
        written = [f"results/{name}" for name in record["results"]]
        runs.append(run_of(tools[-1], inputs, written) | {"startTime": record["started"]})
    rows = [{"@id": name} for name in tables if name.endswith(".rows.csv")]
    runs.append(run_of(tools[0], [*rows, {"@id": "data/published/published.csv"}], ["results/scorecard.csv"]))
    files = [*tables, *tools, "requirements.lock", "data/published/published.csv"]
    parts = [{"@id": name} for name in [*files, "src/", "data/"]]
    whole = {key: about[key] for key in ("name", "description", "datePublished", "version")}
    return {
        "@context": ["https://w3id.org/ro/crate/1.1/context", {"sha256": "http://schema.org/sha256"}],
        "@graph": [
            {
                "@id": CRATE,
                "@type": "CreativeWork",
                "conformsTo": {"@id": "https://w3id.org/ro/crate/1.1"},
                "about": {"@id": "./"},
            },
            {
                "@id": "./",
                "@type": "Dataset",
                **whole,
                "license": {"@id": about["license"]},
                "hasPart": parts,
            },
            {"@id": about["license"], "@type": "CreativeWork", "name": "MIT licence"},
            {"@id": "src/", "@type": "Dataset", "name": "the packages that the notebooks use"},
            {
                "@id": "data/",
                "@type": "Dataset",
                "name": "published numbers, networks, studies and recordings",
            },
            *[file_of(root, name) for name in files],
            *runs,
        ],
    }


def file_of(root: Path, name: str) -> dict[str, Any]:
    """Return what the crate says of a file; what runs is source code as well, as RO-Crate 1.1 asks of scripts."""
    return {
        "@id": name,
        "@type": ["File", "SoftwareSourceCode"] if name.endswith((".ipynb", ".py")) else "File",
        "name": name,
        "encodingFormat": TYPES[Path(name).suffix],
        "contentSize": str((root / name).stat().st_size),
        "sha256": digest(root / name),
    }


def run_of(tool: str, inputs: list[dict[str, str]], written: list[str]) -> dict[str, Any]:
    """Return what the crate says of a run: what ran, what it read, and what it wrote."""
    return {
        "@id": f"#{Path(tool).stem}",
        "@type": "CreateAction",
        "name": f"run of {tool}",
        "instrument": {"@id": tool},
        "object": inputs,
        "result": [{"@id": name} for name in written],
    }


def refuse_recordings(root: Path, files: Mapping[str, Path]) -> None:
    """Stop where a file is one of those that were released without a licence, by its content."""
    groups = json.loads((root / "data/sources.json").read_text(encoding="utf-8")).values()
    entries = [entry for group in groups if "license" not in group for entry in group["files"]]
    known = {entry[kind] for entry in entries for kind in ("sha256", "git_blob") if kind in entry}
    for name, path in files.items():
        content = path.read_bytes()
        blob = hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False)
        if {hashlib.sha256(content).hexdigest(), blob.hexdigest()} & known:
            raise RunFailed(f"{name} is a file of others without a licence, so it cannot be passed on.")


def sealed(files: Mapping[str, Path], archive: Path) -> Path:
    """Write a zip that depends on names and contents alone, and its SHA-256 beside it."""
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as target:
        for name, path in sorted(files.items()):
            entry = zipfile.ZipInfo(f"{archive.stem}/{name}", FIRST_DAY)
            entry.external_attr = (0o755 if os.access(path, os.X_OK) else 0o644) << 16
            target.writestr(entry, path.read_bytes(), zipfile.ZIP_DEFLATED)
    archive.with_name(f"{archive.name}.sha256").write_text(f"{digest(archive)}  {archive.name}\n")
    return archive


def compared(archive: Path) -> str:
    """Unpack an archive in an empty folder and run its own ``repro compare`` there; return what it says."""
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(archive) as source:
            source.extractall(folder)
        project = Path(folder) / archive.stem
        done = subprocess.run(
            [sys.executable, "-m", "repro_companion.cli", "compare"],
            cwd=project,
            env=os.environ | {"PYTHONPATH": str(project / "src")},
            capture_output=True,
            text=True,
            check=False,
        )
    if done.returncode:
        raise RunFailed(f"The unpacked archive is not what was sealed: {done.stderr.strip()}")
    return done.stdout.strip()


def measure(root: Path) -> str:
    """Write what each page took when it was run last, and the site, which is built anew; return where."""
    kind = f"{platform.system()} on {platform.machine().replace('_', '-')} ({get_host_cpu_name()})"
    lines = []
    for notebook in sorted((root / "notebooks").glob("*.ipynb")):
        page = root / "book/notebooks" / notebook.name
        record = read_record(page)
        if record is None:
            raise RunFailed(f"{notebook.stem} has not been run: make book")
        size = page.stat().st_size + sum(
            (root / "results" / name).stat().st_size for name in record["results"]
        )
        lines.append((f"notebooks/{notebook.stem}", record["seconds"], size, " ".join(record["results"])))
    site = root / "book/_build/html"
    seconds = book.build_site(root, site, "-W", "-n", "--keep-going")
    lines.append(
        ("site", seconds, sum(path.stat().st_size for path in site.rglob("*") if path.is_file()), "")
    )
    table = pd.DataFrame(lines, columns=["what", "minutes", "megabytes", "tables"])
    table = table.assign(
        minutes=table["minutes"] / 60,
        megabytes=table["megabytes"] / 1e6,
        machine=f"{kind} with {os.cpu_count()} cores",
    )
    table.to_csv(root / MEASURED, index=False, float_format="%.2g", lineterminator="\n")
    return f"{MEASURED}  ({len(lines) - 1} pages)"


if __name__ == "__main__":
    sys.exit(main())
