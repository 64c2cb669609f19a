"""`isonoise selftest`: numerical checks of the kernels and the allocation rules on the user's device.

`runner.GROUPS` lists all checks. The command and tests/test_selftest.py run the same list.
"""
