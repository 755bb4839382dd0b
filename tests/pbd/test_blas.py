from __future__ import annotations

import os
from pathlib import Path

import pytest

from pbd.blas import choose_kernels

ZEN_5 = "vendor_id\t: AuthenticAMD\nflags\t\t: fpu avx2 avx512f avx512dq avx512cd avx512bw avx512vl avx512_bf16\n"


@pytest.mark.parametrize(
    ("told", "before", "after"),
    [
        (ZEN_5, None, "SkylakeX"),
        (ZEN_5, "Haswell", "Haswell"),  # whoever asks for something gets it
        (ZEN_5.replace("AuthenticAMD", "GenuineIntel"), None, None),  # OpenBLAS knows those
        (ZEN_5.replace("avx512bw ", ""), None, None),
        ("", None, None),
        (None, None, None),
    ],
)
def test_avx_512_of_amd_is_used(
    told: str | None, before: str | None, after: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    if before:
        monkeypatch.setenv("OPENBLAS_CORETYPE", before)
    if told is not None:
        (tmp_path / "cpuinfo").write_text(told, encoding="utf-8")
    choose_kernels(tmp_path / "cpuinfo")
    assert os.environ.get("OPENBLAS_CORETYPE") == after
