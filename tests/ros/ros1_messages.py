"""Generate Python modules of the message definitions in this directory, with genpy of ROS 1; argument: a directory."""

import sys
from pathlib import Path

import genpy.generate_initpy
import genpy.generator
import rospkg

HERE = Path(__file__).parent


def generate(package, into):
    """The modules of a package's messages and services."""
    paths = rospkg.get_ros_paths()
    include = {found.name: [str(found / "msg")] for path in paths for found in Path(path).iterdir()}
    include |= {found.name: [str(found / "msg")] for found in HERE.iterdir() if (found / "msg").is_dir()}
    for kind, generator in (("msg", genpy.generator.MsgGenerator()), ("srv", genpy.generator.SrvGenerator())):
        files = sorted(map(str, (HERE / package / kind).glob(f"*.{kind}")))
        place = into / package / kind
        place.mkdir(parents=True)
        if generator.generate_messages(package, files, str(place), include):
            raise SystemExit(f"genpy cannot make {package}")
        genpy.generate_initpy.write_modules(str(place))
    genpy.generate_initpy.write_modules(str(into / package))


if __name__ == "__main__":
    generate("rosplan_knowledge_msgs", Path(sys.argv[1]))
