// The results of the kernel benchmark: rows of its CSV file, and the ratios that they are read for.

#ifndef TESTS_BENCH_KERNEL_TABLE_H_
#define TESTS_BENCH_KERNEL_TABLE_H_

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace deltaray {

struct KernelRow {
  std::string scene, rays, engine, mode, level;
  uint32_t threads = 1;
  double mrays_s = 0;
  double spread = 0;
};

inline constexpr std::string_view kKernelCsvHeader = "scene,rays,engine,mode,level,threads,mrays_s,spread";
std::string ToCsv(const KernelRow& row);

class KernelTable {
 public:
  explicit KernelTable(std::vector<KernelRow> rows) : rows_(std::move(rows)) {}

  // The fastest of the modes that were measured; nothing where none was.
  std::optional<double> Best(std::string_view scene, std::string_view rays, std::string_view engine,
                             std::initializer_list<std::string_view> modes, std::string_view level,
                             uint32_t threads) const;

  // Lines of text: for each number of threads how many times as fast as Embree deltaray is, by scene and set of rays,
  // with the geometric mean and the minimum of each column. The mode "auto" is compared: of camera rays with Embree's
  // packets, of other sets with the better of its "single" and "1M".
  std::vector<std::string> Summary() const;

 private:
  std::vector<KernelRow> rows_;
};

// Of positive values; nothing where there are none.
std::optional<double> GeometricMean(const std::vector<double>& values);

}  // namespace deltaray

#endif  // TESTS_BENCH_KERNEL_TABLE_H_
