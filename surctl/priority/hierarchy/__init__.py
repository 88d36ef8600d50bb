"""The priority kernel of mode lexicographic: functions in the language of procedures, see `surctl.ir.procedure`."""
