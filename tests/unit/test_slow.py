"""The table of the slow tests: it names its commit, and counts for thirty commits."""

import subprocess

import pytest

from tests.slow import BEGIN, END, MOST_COMMITS, Results, refusal, written


def git(folder, *arguments):
    user = ("-c", "user.name=a test", "-c", "user.email=test@example.org", "-c", "commit.gpgsign=false")
    done = subprocess.run(["git", *user, *arguments], cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def commit(folder, times=1):
    for _ in range(times):
        git(folder, "commit", "-q", "--allow-empty", "-m", "A change")
    return git(folder, "rev-parse", "--short=12", "HEAD")


@pytest.fixture
def readme(tmp_path):
    git(tmp_path, "init", "-q")
    return tmp_path / "README.md"


def write_table(readme, made_on):
    table = Results().table(1.0, made_on)
    readme.write_text(written("# Tests\n", table), encoding="utf-8")


@pytest.mark.parametrize("suffix", ["", "-dirty"])
def test_a_table_counts_until_it_is_thirty_commits_old(readme, suffix):
    made_on = commit(readme.parent)
    write_table(readme, made_on + suffix)
    commit(readme.parent, MOST_COMMITS)
    assert refusal(readme) is None
    commit(readme.parent)
    assert refusal(readme) == (
        f"{readme}: the table of the slow tests is of commit {made_on}, 31 commits old, must be at most 30; "
        "run `python -m tests.slow` and commit the table"
    )


def test_a_table_of_a_commit_that_the_history_lacks_does_not_count(readme):
    commit(readme.parent)
    write_table(readme, "0123456789ab")
    assert "commit 0123456789ab, which this history lacks; run `python -m tests.slow`" in refusal(readme)


def test_a_table_without_its_commit_does_not_count(readme):
    commit(readme.parent)
    readme.write_text(f"# Tests\n\n{BEGIN}\n\n2026-11-25: 71 passed\n\n{END}\n", encoding="utf-8")
    assert "names no commit, must name the one that it was made on" in refusal(readme)
