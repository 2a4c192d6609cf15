from setuptools import find_packages, setup

package_name = "sl_bringup"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The structured-light positioning maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch files, default configurations, demo, bag replay and benchmarks of the structured-light stack.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "demo = sl_bringup.demo:main",
            "replay = sl_bringup.replay:main",
            "benchmark = sl_bringup.benchmark:main",
        ],
    },
)
