# Copyright 2026 fden_ros maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``fden demo``: a synthetic palpation played into the live node, with a picture at the end."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

DESCRIPTION = """\
Make a synthetic palpation bag, play it into the real identifier node over DDS, and show each
contact's estimates and classification beside the truth while they come in. At the end session.png
and result.json lie in the output folder.
"""

_SCENARIO = "demo"
_NAMESPACE = "/fden_demo"
_QUIET_TIMEOUT = 20.0
_SHUTDOWN_TIMEOUT = 10.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command to ``fden``."""
    parser = subparsers.add_parser(
        "demo",
        help="identify a synthetic palpation live",
        description=DESCRIPTION,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("demo"),
        metavar="DIR",
        help="folder of the results; its earlier demo is replaced (default: demo)",
    )
    parser.set_defaults(run=run)


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
    node = _start_identifier(bag / PARAMETER_FILE)
    try:
        session = _listen_while_playing(bag, recording.truth, node)
    finally:
        _stop(node)
    _save(session, args.output)
    return 0


def _start_identifier(parameter_file: Path) -> subprocess.Popen[bytes]:
    arguments = [
        *(sys.executable, "-m", "fden_ros.nodes.programs", "identifier", "--ros-args"),
        *("--params-file", str(parameter_file), "-p", "autostart:=true"),
        *("-r", f"__ns:={_NAMESPACE}", "--log-level", "warn"),
    ]
    return subprocess.Popen(arguments, stdin=subprocess.DEVNULL, env=os.environ.copy())


def _stop(node: subprocess.Popen[bytes]) -> None:
    node.send_signal(signal.SIGINT)
    try:
        node.wait(_SHUTDOWN_TIMEOUT)
    except subprocess.TimeoutExpired:
        node.kill()
        node.wait()


def _listen_while_playing(bag: Path, truth: dict[str, Any], node: subprocess.Popen[bytes]) -> Any:
    from rich.console import Console
    from rich.live import Live

    from fden_ros.errors import InputError
    from fden_ros.nodes.listener import Listener
    from fden_ros.nodes.player import Player
    from fden_ros.report.live import live_view

    sites = {site["site"]: site for site in truth["sites"]}
    problems: list[BaseException] = []
    done = threading.Event()
    with (
        Player(bag, remap=_remap(bag)) as player,
        Listener(f"{_NAMESPACE}/identifier") as listener,
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
            while not (done.is_set() and len(listener.summaries) >= len(truth["contacts"])):
                listener.spin(0.1)
                live.update(live_view(listener.states, listener.summaries, sites))
                if node.poll() is not None:
                    raise InputError(
                        f"the identifier ended early, with exit code {node.returncode}"
                    )
                if problems or (done.is_set() and listener.quiet_for > _QUIET_TIMEOUT):
                    break
        if not console.is_terminal:
            console.line()  # rich ends the last line on terminals only
        player.stop()
        thread.join()
        if problems:
            raise problems[0]
        return listener.session(sites)


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
