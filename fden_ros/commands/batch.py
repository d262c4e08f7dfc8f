# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden batch``: recordings to a table with one row per contact."""

from __future__ import annotations

import argparse
import signal
import sys

from fden_ros.commands.inputs import parameters_of, selection_of

DESCRIPTION = """\
Identify all recordings of an archive, bags of every kind and tables, several
at once, and write a table (CSV) with one row per contact. A recording that
cannot be used gives a row with its error; so does a place without recordings.
Recordings that are in the table already are skipped. A table that was made
with other parameters is refused.
"""

EPILOG = """\
examples:
  fden batch archive/ --config probe.yaml -o results.csv
  fden batch 'archive/2026-*/*.mcap' --config probe.yaml -o results.csv --workers 8
  fden batch s3://lab/day/ --config probe.yaml -o results.parquet --scheduler tcp://host:8786

After an interruption (Ctrl-C) the same command continues.
"""

#: What its exit codes say next to those of all commands.
EXIT_CODES = {
    0: "done (a broken bag gives a row with its error)",
    1: "nothing could be done",
}


def run(args: argparse.Namespace) -> int:
    """Identify the archive; return the exit code."""
    from fden_ros.offline import batch, workers
    from fden_ros.progress import progress

    work = batch.Work(parameters_of(args), selection_of(args))
    bags = batch.find_bags(args.places)
    results = batch.Results(args.output, work.digest())
    left = [bag for bag in bags if not results.has(str(bag))]
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    done = broken = contacts = 0
    with progress("bags", len(left)) as show:

        def see(rows: list[batch.Row]) -> None:
            nonlocal done, broken, contacts
            done += 1
            contacts += rows[0]["contacts"]
            if rows[0]["error"] is not None:
                broken += 1
                bag, error = rows[0]["bag"], rows[0]["error"]
                # The reason often begins with the path.
                _say(f"broken: {error if bag in error else f'{bag}: {error}'}")
            show(done)

        try:
            if args.scheduler and left:
                made = workers.cluster(args.scheduler, _say)
            else:
                made = workers.local(args.workers)
            with made as pool:
                batch.run(left, work, results, pool, see)
        except KeyboardInterrupt:
            count_done = len(bags) - len(left) + done
            _say(
                f"interrupted: {args.output} has {count_done} of {len(bags)} bags; the same "
                "command continues"
            )
            raise
        finally:
            results.close()
    print(
        f"{args.output}: {len(bags)} bags, {len(bags) - len(left)} of them done before, "
        f"{broken} broken; {contacts} new contacts"
    )
    return 0


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
