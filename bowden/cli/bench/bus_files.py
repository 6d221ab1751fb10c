"""`bowden node apply` and `bowden node export`: the bus.yml of ros2_canopen into nodes, and nodes into one."""

from pathlib import Path
from typing import Annotated

import typer

from bowden import output_files
from bowden.cli import options
from bowden.cli.bench.node import Eds, Force, node, refuse_other_master
from bowden.cli.option_groups import Bus
from bowden.cli.terminal import CommandAnswer

File = Annotated[Path, typer.Argument(metavar="FILE", help="bus.yml of ros2_canopen.", show_default=False)]


@node.command()
def apply(file: File, reached: Bus, force: Force = False) -> CommandAnswer:
    """Write the SDO list, heartbeats and PDOs of a bus.yml into its nodes.

    Example: bowden node export -o bus.yml && bowden node apply bus.yml
    """
    from eds.files import bus_yml
    from master.node_access import bus_setup

    devices = bus_yml.read(file).devices
    with reached.linked() as link:
        refuse_other_master(link, force)
        done = {one.name: bus_setup.apply(link, one, file.parent) for one in devices}
    return CommandAnswer(
        {"file": str(file), "devices": [
            {"name": one.name, "node": one.node_id, "done": done[one.name]} for one in devices]},
        [f"{one.name}, node {one.node_id}: {'; '.join(done[one.name]) or 'nothing to write'}." for one in devices])


@node.command()
def export(
    output: options.Output, reached: Bus, eds: Eds = None, overwrite: options.Overwrite = False,
) -> CommandAnswer:
    """Write the nodes of a bus, with their PDOs as they are set, as a bus.yml of ros2_canopen.

    Example: bowden node export -o bus.yml
    """
    import shutil

    from eds.files import bus_yml
    from master.node_access import bus_setup, node_scan

    output_files.refuse([output], overwrite=overwrite)
    files = node_scan.files_of(eds)
    with reached.linked() as link:
        devices = [bus_setup.described(link, one) for one in node_scan.scan(link, files)]
    for path in {path for path in files for one in devices if path.name == one.eds}:
        if not (output.parent / path.name).exists():
            shutil.copy(path, output.parent / path.name)
    bus_yml.write(output, bus_yml.of_devices(devices, {
        "node_id": 127, "driver": "ros2_canopen::MasterDriver", "package": "canopen_master_driver",
        "baudrate": reached.network().bitrate // 1000}), overwrite=overwrite)
    return CommandAnswer({"file": str(output), "nodes": [one.node_id for one in devices]},
                         f"{output}: {len(devices)} nodes.", 0 if devices else 1)
