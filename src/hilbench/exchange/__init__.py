"""The cyclic path: set points out, measurements in; frames stay below."""
