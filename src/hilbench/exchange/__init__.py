"""The cyclic path: set points out, measurements in; CAN frames are hidden below it."""
