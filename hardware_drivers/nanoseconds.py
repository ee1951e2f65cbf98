"""Times in whole nanoseconds: of UTC, or of a monotonic clock."""

NS_PER_S = 1_000_000_000
NS_PER_H = 3600 * NS_PER_S
