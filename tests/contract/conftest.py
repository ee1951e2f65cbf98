from support.doubles_bench import doubles

__all__ = ["doubles"]
