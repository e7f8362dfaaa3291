"""The furniture of all studies: tables, settings, the loop, figures' style, the report. Knows no study."""
