from setuptools import find_packages, setup

package_name = "arm_positioner"

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
    description="Positions an eye-in-hand camera in front of an object, within the limits of the arm.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "positioner = arm_positioner.node:main",
        ],
    },
)
