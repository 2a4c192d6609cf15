from glob import glob

from setuptools import find_packages, setup

package_name = "sl_sim"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/description", glob("sl_sim/description/*.urdf") + glob("sl_sim/description/*.yaml")),
    ],
    package_data={package_name: ["description/*.urdf", "description/*.yaml"]},
    install_requires=["setuptools"],
    zip_safe=False,
    maintainer="The structured-light positioning maintainers",
    maintainer_email="maintainers@example.org",
    description="A simulated cell: arm, ray-cast camera, projector light, driver that counts limit violations.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "cell = sl_sim.node:main",
            "render_dataset = sl_sim.commands.render_dataset:main",
            "render_motion = sl_sim.commands.render_motion:main",
        ],
    },
)
