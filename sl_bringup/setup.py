from glob import glob

from setuptools import find_packages, setup

package_name = "sl_bringup"
share = f"share/{package_name}"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (share, ["package.xml"]),
        (f"{share}/config", glob("config/*")),
        (f"{share}/hook", glob("hook/*")),
        (f"{share}/launch", glob("launch/*.launch.py")),
        (f"{share}/rviz", glob("rviz/*.rviz")),
        (f"{share}/foxglove", glob("foxglove/*.json")),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The structured-light positioning maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch files, default configurations, demo, bag replay and benchmarks of the structured-light stack.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "demo = sl_bringup.commands.demo:main",
            "replay = sl_bringup.commands.replay:main",
            "record_bag = sl_bringup.commands.record_bag:main",
            "benchmark = sl_bringup.commands.benchmark:main",
        ],
    },
)
