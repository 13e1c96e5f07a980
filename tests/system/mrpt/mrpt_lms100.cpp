// A stranger as judge: MRPT's own LMS1xx driver, unmodified, as Debian ships it.
//
//   mrpt_lms100 PORT SCANS SECONDS
//
// Connects to 127.0.0.1, polls SCANS scans (or gives up after SECONDS), and prints lines that a test reads:
//   connected <seconds>
//   scan <seconds since connect> <aperture rad> <right to left 0|1> <n> <range or -1 where invalid> ...
//   end <scans>
#include <mrpt/hwdrivers/CLMS100eth.h>
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
	if (argc != 4)
	{
		std::fprintf(stderr, "usage: mrpt_lms100 PORT SCANS SECONDS\n");
		return 2;
	}
	const int wanted = std::atoi(argv[2]);
	const double limit = std::atof(argv[3]);
	try
	{
		mrpt::hwdrivers::CLMS100Eth laser("127.0.0.1", std::atoi(argv[1]));
		const auto start = Clock::now();
		if (!laser.turnOn())
		{
			std::printf("hardware error\n");
			return 1;
		}
		std::printf("connected %.6f\n", seconds_since(start));
		std::fflush(stdout);

		const auto connected = Clock::now();
		int scans = 0;
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
			++scans;
			const size_t n = scan.getScanSize();
			std::printf("scan %.6f %.9f %d %zu", seconds_since(connected), double(scan.aperture), scan.rightToLeft ? 1 : 0, n);
			for (size_t i = 0; i < n; ++i)
				std::printf(" %.4f", scan.getScanRangeValidity(i) ? double(scan.getScanRange(i)) : -1.0);
			std::printf("\n");
		}
		std::printf("end %d\n", scans);
		return scans == wanted ? 0 : 1;
	}
	catch (const std::exception& failure)
	{
		std::printf("failed %s\n", failure.what());
		return 1;
	}
}
