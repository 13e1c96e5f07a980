// A stranger as judge: MRPT's own LMS2xx driver, unmodified, as Debian ships it.
//
//   mrpt_host PORT BAUD MM FOV RESOLUTION SCANS SECONDS
//
// Connects, reads SCANS scans (or gives up after SECONDS), and prints lines that a test reads:
//   connected <seconds>
//   scan <seconds since connect> <aperture rad> <right to left 0|1> <n> <range or -1 where invalid> ...
//   end <scans> <seconds between first and last scan>
#include <mrpt/hwdrivers/CSickLaserSerial.h>
#include <mrpt/obs/CObservation2DRangeScan.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>

using Clock = std::chrono::steady_clock;

static double seconds_since(Clock::time_point start)
{
	return std::chrono::duration<double>(Clock::now() - start).count();
}

int main(int argc, char** argv)
{
	if (argc != 8)
	{
		std::fprintf(stderr, "usage: mrpt_host PORT BAUD MM FOV RESOLUTION SCANS SECONDS\n");
		return 2;
	}
	const int wanted = std::atoi(argv[6]);
	const double limit = std::atof(argv[7]);
	try
	{
		mrpt::hwdrivers::CSickLaserSerial laser;
		laser.setSerialPort(argv[1]);
		laser.setBaudRate(std::atoi(argv[2]));
		laser.setMillimeterMode(std::atoi(argv[3]) != 0);
		laser.setScanFOV(std::atoi(argv[4]));
		laser.setScanResolution(std::atoi(argv[5]));

		const auto start = Clock::now();
		{
			// the driver connects in its first call
			bool there = false, error = false;
			mrpt::obs::CObservation2DRangeScan scan;
			laser.doProcessSimple(there, scan, error);
			if (error)
			{
				std::printf("hardware error\n");
				return 1;
			}
		}
		std::printf("connected %.6f\n", seconds_since(start));
		std::fflush(stdout);

		const auto connected = Clock::now();
		int scans = 0;
		double first = 0, last = 0;
		while (scans < wanted && seconds_since(connected) < limit)
		{
			bool there = false, error = false;
			mrpt::obs::CObservation2DRangeScan scan;
			laser.doProcessSimple(there, scan, error);
			if (error)
			{
				std::printf("hardware error\n");
				return 1;
			}
			if (!there) continue;
			last = seconds_since(connected);
			if (scans == 0) first = last;
			++scans;
			const size_t n = scan.getScanSize();
			std::printf("scan %.6f %.9f %d %zu", last, double(scan.aperture), scan.rightToLeft ? 1 : 0, n);
			for (size_t i = 0; i < n; ++i)
				std::printf(" %.4f", scan.getScanRangeValidity(i) ? double(scan.getScanRange(i)) : -1.0);
			std::printf("\n");
			std::fflush(stdout);
		}
		std::printf("end %d %.6f\n", scans, last - first);
		return scans == wanted ? 0 : 1;
	}
	catch (const std::exception& failure)
	{
		std::printf("failed %s\n", failure.what());
		return 1;
	}
}
