// A stranger as judge: MRPT's own Hokuyo driver, unmodified, as Debian ships it.
//
//   hokuyo_host tcp:PORT|DEVICE SCANS SECONDS
//
// Prints lines that a test reads: connected; scan <aperture rad> <n> <range or -1 where invalid> ...
#include <mrpt/hwdrivers/CHokuyoURG.h>
#include <mrpt/obs/CObservation2DRangeScan.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>

int main(int argc, char** argv)
{
	if (argc != 4) return 2;
	using Clock = std::chrono::steady_clock;
	try
	{
		mrpt::hwdrivers::CHokuyoURG laser;
		const std::string where = argv[1];
		if (where.rfind("tcp:", 0) == 0)
			laser.setIPandPort("127.0.0.1", std::atoi(where.c_str() + 4));
		else
			laser.setSerialPort(where);
		static_cast<mrpt::hwdrivers::CGenericSensor&>(laser).initialize();
		if (!laser.turnOn()) return 1;
		std::printf("connected\n");
		std::fflush(stdout);
		const auto start = Clock::now();
		int scans = 0;
		while (scans < std::atoi(argv[2]) && std::chrono::duration<double>(Clock::now() - start).count() < std::atof(argv[3]))
		{
			bool there = false, error = false;
			mrpt::obs::CObservation2DRangeScan scan;
			laser.doProcessSimple(there, scan, error);
			if (error) return 1;
			if (!there) continue;
			++scans;
			std::printf("scan %.6f %zu", double(scan.aperture), scan.getScanSize());
			for (size_t i = 0; i < scan.getScanSize(); ++i)
				std::printf(" %.4f", scan.getScanRangeValidity(i) ? double(scan.getScanRange(i)) : -1.0);
			std::printf("\n");
		}
		laser.turnOff();
		return scans == std::atoi(argv[2]) ? 0 : 1;
	}
	catch (const std::exception& failure)
	{
		std::printf("failed %s\n", failure.what());
		return 1;
	}
}
