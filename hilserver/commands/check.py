"""Validate a configuration, say what it means and what the daemon will do with it."""

import argparse
from collections.abc import Iterator

from hilserver.commands.options import add_config, config_path, out_file, write_text
from hilserver.commands.validation import validate
from hilserver.config.blocks import BlockConfig
from hilserver.config.root import Config
from hilserver.config.section import schema_text
from hilserver.daemon.assembly import Assembly, assemble
from hilserver.daemon.doors import doors_lost, table_of_doors
from hilserver.daemon.soundness import doubts
from hilserver.errors import EXIT_DONE
from hilserver.plant.layout import WHEELS

EXAMPLE = "hilserver check -c config.yaml"
TWIST = ("twist.linear_m_s", "twist.angular_rad_s")
WHEEL_SETPOINTS = tuple(f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``-c`` and ``--schema``."""
    add_config(parser)
    parser.add_argument(
        "--schema",
        type=out_file,
        metavar="FILE",
        help="write the JSON Schema of config.yaml for editors and exit",
    )


def run(args: argparse.Namespace) -> int:
    """Check; every error is one line with file, line and key (exit code 78)."""
    if args.schema is not None:
        write_text(args.schema, schema_text(Config))
        return EXIT_DONE
    assembly = assemble(config_path(args))
    validate(assembly)
    print("\n".join(describe(assembly)))
    return EXIT_DONE


def describe(assembly: Assembly) -> list[str]:
    """Return what a configuration means, in sentences."""
    config = assembly.config
    robot = assembly.robot
    scheduler = config.scheduler
    lines = [
        f"configuration: {assembly.path or 'built-in defaults'} (sha256 {config.sha256[:12]})",
        f"robot: wheel radius {robot.wheel_radius_m:g} m, track {robot.track_m:g} m,"
        f" K_om {robot.k_om:.4g} 1/m, yaw_sign {robot.yaw_sign:+d}",
        f"limits: {robot.max_rpm:g} rpm = {robot.max_linear_m_s:.3g} m/s straight ahead,"
        f" {robot.max_angular_rad_s:.3g} rad/s on the spot",
        f"pacing: {scheduler.backend}, base period {scheduler.base_period_ms:g} ms,"
        f" overrun policy {scheduler.policy}",
    ]
    for part in assembly.slices:
        kind = "compiled, paced" if part.compiled else "communication, asyncio"
        period_ms = part.period_ticks * scheduler.base_period_ms
        lines.append(f"slice {part.name}: every {period_ms:g} ms ({kind})")
    terms = {
        name: value for name, value in config.plant.terms.items() if value is not None
    }
    lines.append(
        f"terms: {', '.join(f'{n} = {v:g}' for n, v in terms.items()) or 'none'}"
    )
    lines += [_block(block) for block in config.blocks]
    lines += _links(assembly)
    lines.append(
        f"control: '{config.first_source}' has control at the start; sources, highest first:"
        f" {', '.join(config.sources)}"
    )
    lines.append(config.after_reset)
    lines.append(f"OPC UA: {config.opcua.endpoint if config.opcua.enabled else 'off'}")
    metrics = config.metrics
    if metrics.enabled:
        address = f"http://{metrics.host}:{metrics.port}/metrics"
    else:
        address = "off"
    lines.append(f"metrics: {address}")
    page = config.page
    foxglove = config.foxglove
    scheme = "https" if page.tls else "http"
    lines.append(
        f"page: {f'{scheme}://{page.host}:{page.port}/' if page.enabled else 'off'}"
    )
    if foxglove.enabled:
        lines.append(f"foxglove: ws://{foxglove.host}:{foxglove.port}")
    lines += ["doors, and who may do what besides watching:", *table_of_doors(config)]
    return lines + [f"warning: {text}" for text in warnings(assembly)]


def _links(assembly: Assembly) -> Iterator[str]:
    for link in assembly.config.links:
        driver = link.driver
        about = link.about(assembly.folder)
        if driver.is_enabled:
            about += f", stale after {driver.limit_ms:g} ms: {driver.on_stale}"
        if about:
            yield f"link {driver.name}: {about}"


def _block(block: BlockConfig) -> str:
    place = ", in a process of its own, one slice behind" if block.process else ""
    origin = block.function or block.fmu
    return f"own block {block.name}: {origin} in slice {block.slice}{place}"


def warnings(assembly: Assembly) -> list[str]:
    """Return what is allowed but probably not intended."""
    foreign = [
        f"{why}: snapshots do not restore it, and recordings are not replayable"
        for why in assembly.not_replayable
    ]
    lost = doors_lost(assembly.config)
    return foreign + assembly.remarks + lost + doubts(assembly) + _idle_peers(assembly)


def _idle_peers(assembly: Assembly) -> list[str]:
    config = assembly.config
    table = assembly.table
    driving = [
        link for link in config.links if link.drives and link.driver.kind == "peer"
    ]
    if config.first_source != "peer" or driving != [*config.peers]:
        return []
    read = {name for peer in config.peers for name in peer.inputs}
    if not read.isdisjoint(TWIST):
        if "control.mode" in read:
            return []
        return [
            "peers set the twist, but none sets control.mode: it starts at 0 (wheels), and the"
            " twist has no effect until 1 is written to it"
        ]
    commanded = {slot for name in read for slot in table[name].slots}
    idle = [name for name in WHEEL_SETPOINTS if table.slot(name) not in commanded]
    if not idle:
        return []
    return [
        f"'peer' has control at start, but no peer sets {', '.join(idle)}: these wheels stand"
        " still; one node may feed several inputs, as in 'ns=1;s=left':"
        " [wheel.fl.setpoint_rpm, wheel.rl.setpoint_rpm]"
    ]
