# SPDX-FileCopyrightText: 2026 fden_ros maintainers
# SPDX-License-Identifier: Apache-2.0

"""``fden demo``: a synthetic palpation played into the live node, with a picture at the end."""

from __future__ import annotations

import argparse
import json
import threading
from pathlib import Path
from typing import Any

from fden_ros.commands.command import Command
from fden_ros.commands.processes import Nodes, running

DESCRIPTION = """\
Make a synthetic palpation bag, play it into the real identifier node over DDS, and show each
contact's estimates and classification beside the truth while they come in. At the end session.png
and result.json lie in the output folder.
"""

EPILOG = """\
examples:
  fden demo
  fden demo -o /tmp/demo             the results elsewhere
"""

_SCENARIO = "demo"
_NAMESPACE = "/fden_demo"
_QUIET_TIMEOUT = 20.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add its arguments."""
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("demo"),
        metavar="DIR",
        help="folder of the results; its earlier demo is replaced (default: demo)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the demonstration; return the exit code."""
    from fden_ros.parameters import read_parameter_file
    from fden_ros.recording.synthetic import PARAMETER_FILE, write_recording
    from fden_ros.simulation.scenario import load_scenario
    from fden_ros.simulation.simulate import simulate

    args.output.mkdir(parents=True, exist_ok=True)
    bag = args.output / "bag"
    recording = simulate(load_scenario(_SCENARIO))
    write_recording(recording, bag, overwrite=bag.exists())
    print(f"made {bag}, {len(recording.truth['sites'])} sites; starting the identifier ...")
    read_parameter_file(bag / PARAMETER_FILE)
    settings = {"identifier": "autostart:=true"}
    with running(bag / PARAMETER_FILE, _NAMESPACE, settings) as nodes:
        session = _listen_while_playing(bag, recording.truth, nodes)
    _save(session, args.output)
    return 0


def _listen_while_playing(bag: Path, truth: dict[str, Any], nodes: Nodes) -> Any:
    from rich.console import Console
    from rich.live import Live

    from fden_ros.nodes.monitor import Monitor
    from fden_ros.nodes.player import Player
    from fden_ros.report.figure import Session
    from fden_ros.report.monitor import monitor_view

    sites = {site["site"]: site for site in truth["sites"]}
    problems: list[BaseException] = []
    done = threading.Event()
    with (
        Player(bag, remap=_remap(bag)) as player,
        Monitor(f"{_NAMESPACE}/identifier", keeps_states=True) as monitor,
    ):

        def play() -> None:
            try:
                player.wait_for_subscribers()
                player.play()
                player.wait_until_acknowledged()
            except BaseException as error:
                problems.append(error)
            finally:
                done.set()

        thread = threading.Thread(target=play, name="player", daemon=True)
        thread.start()
        console = Console()
        with Live(console=console, refresh_per_second=5, transient=False) as live:
            while not (done.is_set() and len(monitor.summaries) >= len(truth["contacts"])):
                monitor.spin(0.1)
                live.update(monitor_view(monitor.view(), sites))
                nodes.require_alive()
                if problems or (done.is_set() and monitor.quiet_for > _QUIET_TIMEOUT):
                    break
        if not console.is_terminal:
            console.line()  # rich ends the last line on terminals only
        player.stop()
        thread.join()
        if problems:
            raise problems[0]
        return Session(tuple(monitor.states), tuple(monitor.summaries), sites)


def _remap(bag: Path) -> dict[str, str]:
    from fden_ros.recording.reader import BagReader

    return {topic.name: f"{_NAMESPACE}{topic.name}" for topic in BagReader(bag).topics}


def _save(session: Any, folder: Path) -> None:
    from fden_ros.offline.replay import contact_object
    from fden_ros.report.figure import save_session_figure

    contacts = []
    for summary in session.summaries:
        site = session.truth.get(summary.site_id, {})
        keys = ("linear_stiffness", "nonlinear_stiffness", "fractional_order")
        truth = {
            short: site.get(key) for short, key in zip(("g", "g_n", "alpha"), keys, strict=True)
        }
        contacts.append({**contact_object(summary), "truth": truth})
    result = folder / "result.json"
    result.write_text(json.dumps({"contacts": contacts}, indent=2, allow_nan=False) + "\n")
    picture = folder / "session.png"
    save_session_figure(session, picture, "Synthetic palpation, identified live")
    print(f"wrote {picture} and {result}")


COMMAND = Command(
    "demo",
    "identify a synthetic palpation live",
    DESCRIPTION,
    EPILOG,
    add_arguments,
    run,
)
