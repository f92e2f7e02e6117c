"""From recorded driving to laps: bags and CSV files, lap statistics, reports and plots."""
