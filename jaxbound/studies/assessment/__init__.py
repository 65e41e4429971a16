"""False alarms, missed ones and delays of a monitor on recordings whose truth is known."""
