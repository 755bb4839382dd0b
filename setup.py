"""Puts the list of locked dependencies into the wheel's folder `sboms` (PEP 770), for which setuptools has no key."""

from pathlib import Path
from shutil import copy

from setuptools import setup
from setuptools.command.egg_info import egg_info


class WithBillOfMaterials(egg_info):
    """The files in the folder of this command become the wheel's `.dist-info`."""

    def run(self) -> None:
        super().run()
        folder = Path(self.egg_info) / "sboms"
        folder.mkdir(exist_ok=True)
        copy(Path(__file__).with_name("dependencies.cdx.json"), folder)


setup(cmdclass={"egg_info": WithBillOfMaterials})
