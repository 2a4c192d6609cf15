from setuptools import find_packages, setup

package_name = "sl_calibration"

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
    description="Calibration of camera, projector, hand-eye and colours, with and without a grid; triangulation.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "triangulator = sl_calibration.nodes.triangulator:main",
            "calibrator = sl_calibration.nodes.calibrator:main",
            "calibrate_camera = sl_calibration.commands.calibrate_camera:main",
            "calibrate_procam = sl_calibration.commands.calibrate_procam:main",
            "hand_eye = sl_calibration.commands.hand_eye:main",
            "self_calibrate = sl_calibration.commands.self_calibrate:main",
            "triangulate = sl_calibration.commands.triangulate:main",
            "colours = sl_calibration.commands.colours:main",
        ],
    },
)
