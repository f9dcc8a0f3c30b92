#include "client/build_watcher.h"

#include <algorithm>
#include <memory>

#include "absl/strings/str_cat.h"
#include "client/enum_names.h"
#include "client/exit_code.h"
#include "client/progress_bar.h"
#include "client/retry.h"
#include "client/text_table.h"

namespace deltaray {

absl::Status WatchBuild(Connection& connection, const Session& session, const std::string& mesh,
                        absl::FunctionRef<absl::Status(const v1::WatchBuildResponse&)> report) {
  v1::WatchBuildRequest request;
  request.set_mesh(mesh);
  ProgressBar bar(session.messages, session.show_progress);
  v1::WatchBuildResponse response;
  Retry retry(connection);
  grpc::Status rpc_status;
  do {
    grpc::ClientContext context;
    connection.Prepare(mesh, &context);
    const StopSignal::Scope scope(connection.stop(), context);
    const auto reader = connection.meshes().WatchBuild(&context, request);
    absl::Status report_status;
    while (report_status.ok() && reader->Read(&response)) {
      retry.Succeeded();
      bar.Update(BuildFraction(response.progress()), BuildText(response.progress()));
      report_status = report(response);
    }
    if (!report_status.ok()) context.TryCancel();
    rpc_status = WithRequestId(reader->Finish(), context);
    if (!report_status.ok()) return report_status;
  } while (retry.Again(rpc_status));
  if (!rpc_status.ok()) return connection.Result(rpc_status);
  if (response.progress().state() == v1::MESH_STATE_FAILED) {
    return LocalError(absl::StrCat("the build failed: ", response.progress().failure()));
  }
  return absl::OkStatus();
}

absl::Status WatchBuild(Connection& connection, const Session& session, const std::string& mesh) {
  return WatchBuild(connection, session, mesh, [](const v1::WatchBuildResponse&) { return absl::OkStatus(); });
}

double BuildFraction(const v1::BuildProgress& progress) {
  if (progress.phase() == v1::BUILD_PHASE_DONE) return 1;
  double fraction = 0;
  if (progress.phase() > v1::BUILD_PHASE_TOP) {
    fraction += 0.5;
  } else if (progress.triangles() > 0) {
    // Duplicated references count too, so that the top can place more than there are triangles.
    fraction += 0.5 * std::min(1.0, static_cast<double>(progress.references_placed()) / progress.triangles());
  }
  if (progress.delta_leaves() > 0 && progress.phase() >= v1::BUILD_PHASE_DELTA_LEAVES) {
    fraction += 0.5 * progress.delta_leaves_built() / progress.delta_leaves();
  }
  return fraction;
}

std::string BuildText(const v1::BuildProgress& progress) {
  switch (progress.phase()) {
    case v1::BUILD_PHASE_TOP:
      return absl::StrCat("top: ", GroupDigits(progress.references_placed()), " references placed, ",
                          GroupDigits(progress.triangles()), " triangles");
    case v1::BUILD_PHASE_DELTA_LEAVES:
      return absl::StrCat("δ-leaves: ", GroupDigits(progress.delta_leaves_built()), " of ",
                          GroupDigits(progress.delta_leaves()));
    default:
      return EnumName(progress.phase());
  }
}

}  // namespace deltaray
