from setuptools import find_packages, setup

package_name = "sl_decoder"

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
    description="Decodes single-shot structured light: camera images to camera-projector correspondences.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "decoder = sl_decoder.node:main",
            "decode_images = sl_decoder.commands.decode_images:main",
        ],
    },
)
