"""Compiles every Triton kernel for a GPU that need not be there; a program of its own, since tests interpret them."""

import triton
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource

from regtorch.drr.triton import joseph_kernels
from regtorch.drr.triton import kernels as drr
from regtorch.similarity.triton import kernels as similarity

TARGET = GPUTarget("cuda", 80, 32)
TYPES = {
    "data": "*fp32", "total": "*i64", "rays": "*fp64", "ray_jacobian": "*fp64", "grid": "*fp64", "sums": "*fp64",
    "images": "*fp32", "jacobian": "*fp32", "image_gradients": "*fp32",
    "slices": "*fp32", "tables": "*i32", "numbers": "*i16", "records": "*fp32",
    "fixed": "*fp32", "root": "*fp32", "squares": "*fp32",
}  # fmt: skip
TILE = {"TILE_ROWS": 8, "TILE_COLUMNS": 16}


def compile_kernel(kernel: triton.JITFunction, types: dict[str, str] | None = None, **constants: object) -> None:
    types = TYPES | (types or {})
    signature = {n: "constexpr" if n in constants else types.get(n, "i32") for n in kernel.arg_names}
    places = {(kernel.arg_names.index(name),): value for name, value in constants.items()}
    done = triton.compile(ASTSource(kernel, signature, places), target=TARGET, options={"enable_fp_fusion": True})
    assert done.asm["cubin"]
    print(kernel.__name__, *constants.values())


if __name__ == "__main__":
    compile_kernel(similarity.gradient_sums, {"parts": "*fp64"}, WIDTH=128)
    compile_kernel(similarity.gradient_products, {"parts": "*fp32"}, HEIGHT=16, WIDTH=64, PRECISION="tf32x3")
    compile_kernel(joseph_kernels.joseph_survey, BORDER=2, AT_ONCE=64, **TILE)
    for sharp in (False, True):
        compile_kernel(joseph_kernels.joseph_project, BLOCK=2, BORDER=2, SHARP=sharp, **TILE)
    compile_kernel(joseph_kernels.joseph_project_with_jacobian, BLOCK=2, BORDER=2, SHARP=True, **TILE)
    compile_kernel(joseph_kernels.joseph_pull_back_rays, BLOCK=2, BORDER=2, SHARP=False, **TILE)
    compile_kernel(drr.pull_back_data, METHOD="joseph", CHANNELS=1, PADDED=1, **TILE)
    for method in ("siddon", "trilinear"):
        compile_kernel(drr.pull_back_rays, METHOD=method, CHANNELS=1, PADDED=1, **TILE)
        compile_kernel(drr.pull_back_data, METHOD=method, CHANNELS=1, PADDED=1, **TILE)
    compile_kernel(drr.project, METHOD="siddon", CHANNELS=3, PADDED=4, **TILE)
    compile_kernel(drr.project_with_jacobian, METHOD="siddon", CHANNELS=3, PADDED=4, **TILE)
