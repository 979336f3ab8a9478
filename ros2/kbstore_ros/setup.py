"""The ROS 2 package `kbstore_ros`: a launch file, and the nodes of an installed kbstore as executables."""

from setuptools import setup

setup(
    name="kbstore_ros",
    version="0.1.0",
    packages=["kbstore_ros"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/kbstore_ros"]),
        ("share/kbstore_ros", ["package.xml"]),
        ("share/kbstore_ros/launch", ["launch/experts_launch.py", "launch/record_launch.py"]),
    ],
    install_requires=["setuptools", "kbstore"],
    zip_safe=True,
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "experts = kbstore_ros.executables:experts",
            "record = kbstore_ros.executables:record",
        ]
    },
)
