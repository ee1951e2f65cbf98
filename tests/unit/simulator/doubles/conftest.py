from support.doubles_bench import double_library, doubles, meeting

__all__ = ["double_library", "doubles", "meeting"]
