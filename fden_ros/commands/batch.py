# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch``: an archive of bags, a row a contact."""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fden_ros.commands.command import Command, count
from fden_ros.commands.inputs import add_input_options, parameters_of, selection_of
from fden_ros.errors import InputError

DESCRIPTION = """\
Identify all bags of an archive and write a table (Parquet), a row a contact. The work is done by
processes of this machine, or by the workers of a Dask cluster. A bag that cannot be used is a row
with its error. Bags that are done, with this content and configuration, are not done again.
"""

EPILOG = """\
examples:
  fden batch archive/ --config probe.yaml -o results.parquet
  fden batch 'archive/2026-*/*.mcap' --config probe.yaml -o results.parquet --workers 8
  fden batch /nfs/archive --config probe.yaml -o results.parquet --scheduler tcp://head:8786

The dashboard shows what each worker does. The workers of a cluster need fden_ros of this version
and must see the bags at the same paths. Interrupted (Ctrl-C), it saves what is done and goes on
from there the next time. Exit codes: 0 done (broken bags are rows), 1 nothing could be done, 2
wrong usage.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "places", nargs="+", metavar="DIR_OR_GLOB", help="folders of bags, bags, or patterns"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="the table, Parquet"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=count,
        metavar="N",
        help="processes on this machine (default: one a processor core)",
    )
    where.add_argument("--scheduler", metavar="ADDRESS", help="a Dask cluster: tcp://HOST:8786")
    add_input_options(parser)


def run(args: argparse.Namespace) -> int:
    """Identify the archive; return the exit code."""
    try:
        import distributed  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise InputError(
            f"fden batch needs {error.name}: pip install 'fden_ros[batch]', or pip install "
            "bokeh dask distributed pyarrow"
        ) from None
    from fden_ros.offline import batch
    from fden_ros.progress import progress as bar

    work = batch.Work(parameters_of(args), selection_of(args))
    if args.columns is not None:
        args.parser.error("--columns is for a single table: give bags to batch")
    bags = batch.find_bags(args.places)
    work.digest()
    results = batch.Results(args.output)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _client(args.workers, args.scheduler) as client, bar("bags", len(bags)) as show:
            print(f"{len(bags)} bags; dashboard: {client.dashboard_link}", file=sys.stderr)
            progress = batch.run(
                bags, work, results, client, lambda now: show(now.done), _tell_broken
            )
    finally:
        results.save()
    print(
        f"{args.output}: {progress.done} bags, {progress.skipped} of them done before, "
        f"{progress.broken} broken; {progress.contacts} contacts new"
    )
    return 0


def _tell_broken(bag: str, error: str) -> None:
    # The reason often begins with the path.
    print(f"broken: {error if bag in error else f'{bag}: {error}'}", file=sys.stderr)


@contextlib.contextmanager
def _client(workers: int | None, scheduler: str | None) -> Iterator[Any]:
    from distributed import Client, LocalCluster

    with contextlib.ExitStack() as stack:
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=10.0, set_as_default=False)
            except (OSError, ValueError) as error:
                reason = " ".join(str(error).split())
                raise InputError(
                    f"no Dask scheduler answers at {scheduler} ({reason}): start one with "
                    "dask scheduler, and workers with dask worker ADDRESS"
                ) from None
            yield stack.enter_context(client)
            return
        # Threads would wait for each other: the work is Python. Nothing of it is to be seen from
        # other machines.
        cluster = stack.enter_context(
            LocalCluster(
                n_workers=workers or _cores(),
                threads_per_worker=1,
                processes=True,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                silence_logs="ERROR",
            )
        )
        yield stack.enter_context(Client(cluster, set_as_default=False))


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0))


COMMAND = Command("batch", "identify an archive of bags", DESCRIPTION, EPILOG, add_arguments, run)
