from setuptools import find_packages, setup

package_name = "pattern_gen"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    package_data={package_name: ["catalogue/*.yaml"]},
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The structured-light positioning maintainers",
    maintainer_email="maintainers@example.org",
    description=(
        "Rotation-invariant perfect maps with a minimum Hamming distance: generation, verification, rendering."
    ),
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "pattern_publisher = pattern_gen.node:main",
            "generate = pattern_gen.commands.generate:main",
            "verify = pattern_gen.commands.verify:main",
            "export = pattern_gen.commands.export:main",
            "tables = pattern_gen.commands.tables:main",
        ],
    },
)
