"""The binary interface between XLA and a function that it calls: every offset and version, once.

Source: `xla/ffi/api/c_api.h`, which jaxlib installs in `jaxlib/include`; version 0.3 of the interface. XLA says that
fields are only added at the end of its structures, so that the offsets hold within a major version. Offsets are in
bytes, for pointers of 8 bytes and the alignment rules of C. `tests/compiler/test_private.py` compiles the header that
is installed and compares each of them.

If an offset were wrong, a function would read numbers from somewhere else. That cannot be noticed at run time.
Therefore machine code is made with the versions of jaxlib in `KNOWN_JAXLIB` alone, for which the tests have been run;
with any other version XLA compiles everything, and one warning says so.
"""

KNOWN_JAXLIB = (0, 10), (0, 12)
"""First and last version (major, minor) of jaxlib that this has been tested with; with another one XLA compiles all."""

API_MAJOR, API_MINOR = 0, 3
"""XLA_FFI_API_MAJOR, XLA_FFI_API_MINOR: the interface that functions say they keep to."""

REGISTERED_API_VERSION = 1
"""`api_version` of `jax.ffi.register_ffi_target`: typed handlers, which take an XLA_FFI_CallFrame."""

# struct XLA_FFI_CallFrame
FRAME_EXTENSION = 8
"""extension_start: null in an ordinary call."""

FRAME_ARGUMENTS = 72
"""args.args: an array of pointers to buffers. `args` is at 40; within it come struct_size, extension_start, size and
types, 8 bytes each."""

FRAME_RESULTS = 112
"""rets.rets: the same for results. `rets` is at 80."""

FRAME_WORDS = 16
"""Words of 8 bytes that hold all fields of a frame which a function of ours reads; the others are zero."""

# struct XLA_FFI_Buffer
BUFFER_DATA = 24
"""data: where the numbers are; behind struct_size, extension_start and dtype (which is padded to 8 bytes)."""

# struct XLA_FFI_Extension_Base, XLA_FFI_Metadata_Extension
EXTENSION_TYPE = 8
EXTENSION_METADATA = 1
"""XLA_FFI_Extension_Metadata: the call asks what the function is, and evaluates nothing."""

METADATA_OF_EXTENSION = 24
"""metadata: behind the base of the extension."""

# struct XLA_FFI_Metadata
METADATA_MAJOR = 24
"""api_version.major_version: `api_version` is at 8."""

METADATA_MINOR = 28
METADATA_TRAITS = 32
"""traits: 0, none of them holds. A function of ours may be called by several threads, but it is no command buffer."""


def beginning(function: str) -> str:
    """The text with which a function begins that XLA calls: it answers what it is, or finds its buffers.

    Args:
        function: its name.
    """
    return f"""\
define ptr @{function}(ptr noalias %frame) nounwind {{
  %p.extension = getelementptr inbounds i8, ptr %frame, i64 {FRAME_EXTENSION}
  %extension = load ptr, ptr %p.extension
  %is.plain = icmp eq ptr %extension, null
  br i1 %is.plain, label %work, label %extended
extended:
  %p.kind = getelementptr inbounds i8, ptr %extension, i64 {EXTENSION_TYPE}
  %kind = load i32, ptr %p.kind
  %is.asked = icmp eq i32 %kind, {EXTENSION_METADATA}
  br i1 %is.asked, label %asked, label %work
asked:
  %p.metadata = getelementptr inbounds i8, ptr %extension, i64 {METADATA_OF_EXTENSION}
  %metadata = load ptr, ptr %p.metadata
  %p.major = getelementptr inbounds i8, ptr %metadata, i64 {METADATA_MAJOR}
  store i32 {API_MAJOR}, ptr %p.major
  %p.minor = getelementptr inbounds i8, ptr %metadata, i64 {METADATA_MINOR}
  store i32 {API_MINOR}, ptr %p.minor
  %p.traits = getelementptr inbounds i8, ptr %metadata, i64 {METADATA_TRAITS}
  store i32 0, ptr %p.traits
  ret ptr null
work:
  %p.arguments = getelementptr inbounds i8, ptr %frame, i64 {FRAME_ARGUMENTS}
  %arguments = load ptr, ptr %p.arguments
  %p.results = getelementptr inbounds i8, ptr %frame, i64 {FRAME_RESULTS}
  %results = load ptr, ptr %p.results
"""
